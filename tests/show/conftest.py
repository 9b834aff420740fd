"""A small table, for every view."""

import pytest
from made_up_points import made_up_point

from vocc_torch.measure.curve import BerTable


@pytest.fixture
def table():
    """Two receivers over three values out of order; flda_3 has no errors at 8000 lx."""
    wrong = {("flda_2", 32000): 90, ("flda_2", 8000): 3, ("flda_2", 1000): 200}
    wrong |= {("flda_3", 1000): 100, ("flda_3", 8000): 0, ("flda_3", 32000): 60}
    return BerTable([made_up_point(value, receiver, number) for (receiver, value), number in wrong.items()])
