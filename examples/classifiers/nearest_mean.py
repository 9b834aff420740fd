"""A classifier of your own, in a file outside the package: decides for the class whose mean is nearer.

vocc-torch classifier=own classifiers.own.file=examples/classifiers/nearest_mean.py \
        classifiers.own.build._target_=NearestMean
"""

import torch


class NearestMean:
    """Remember the mean of each class; score by the difference of the distances."""

    def fit(self, x, bits):
        """Learn from ``x`` (B,R,C,F) with bits (B,R,C)."""
        self.spread = x.flatten(0, -2).std(dim=0)
        self.off, self.on = (
            x[~bits].mean(dim=0) / self.spread,
            x[bits].mean(dim=0) / self.spread,
        )
        return self

    def decision_function(self, x):
        """Score (B,R,C): at least 0 is On."""
        scaled = x / self.spread
        return torch.linalg.vector_norm(
            scaled - self.off, dim=-1
        ) - torch.linalg.vector_norm(scaled - self.on, dim=-1)

    def predict(self, x):
        """Decide (B,R,C)."""
        return self.decision_function(x) >= 0
