"""A torch module of your own: it weighs the eight neighbours of an LED before it decides.

    vocc-torch classifier=own classifiers.own.file=examples/classifiers/attention_net.py \
        classifiers.own.build._target_=NeighbourNet '+classifiers.own.inputs.patch={cells: 3, samples: 1}'

The package trains it; batches, validation, early stopping and seed are those of ``classifiers.own.training``.
"""

import torch
from torch import nn


class NeighbourNet(nn.Module):
    """Give (N,) scores from (N,F) inputs; the package says how many inputs there are."""

    def __init__(self, n_inputs, hidden=24):
        super().__init__()
        self.weigh = nn.Linear(n_inputs, n_inputs)
        self.decide = nn.Sequential(
            nn.Linear(n_inputs, hidden), nn.Tanh(), nn.Linear(hidden, 1)
        )

    def forward(self, x):
        """Score."""
        return self.decide(x * torch.sigmoid(self.weigh(x))).squeeze(-1)
