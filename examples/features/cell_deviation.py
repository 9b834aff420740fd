"""A feature of your own: how much the grey varies in an LED's cell: much where an On LED stands out.

vocc-torch receiver.features=[agr,gri,examples/features/cell_deviation.py:cell_deviation]
"""


def cell_deviation(patches, shape):
    """Measure rectified panels (B,1,(R+2)K,(C+2)K), which have a cell more on each side; (B,R,C)."""
    side = patches.shape[-1] // (shape.columns + 2)
    cells = patches[:, 0].double().unfold(1, side, side).unfold(2, side, side)
    return cells[:, 1:-1, 1:-1].flatten(3).std(dim=3)
