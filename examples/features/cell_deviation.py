"""A feature of your own: the standard deviation of the grey in an LED's cell, which is larger for On LEDs.

vocc-torch receiver.features=[agr,gri,examples/features/cell_deviation.py:cell_deviation]
"""


def cell_deviation(patches, shape):
    """Measure rectified panels (B,1,(R+2)K,(C+2)K), with a border one cell wide; returns (B,R,C)."""
    side = patches.shape[-1] // (shape.columns + 2)
    cells = patches[:, 0].double().unfold(1, side, side).unfold(2, side, side)
    return cells[:, 1:-1, 1:-1].flatten(3).std(dim=3)
