"""Every command leaves what it left when it was frozen."""

import pytest
from golden import main


@pytest.mark.slow
def test_nothing_a_user_has_is_lost(capsys):
    status = main(["check"])
    assert status == 0, capsys.readouterr().out
