"""What a run says at its end."""

import io
from pathlib import Path

from rich.console import Console

from vocc_torch.report.folder import print_places


def test_every_place_is_a_line_and_the_board_a_command_and_an_address():
    console = Console(file=io.StringIO(), width=60)
    print_places(console, Path("runs/a b"), [("table", "ber.csv")], board=True)
    table, command, address = console.file.getvalue().splitlines()
    assert table == "table     runs/a b/ber.csv"
    assert command == "dashboard tensorboard --logdir 'runs/a b/tensorboard'"
    assert address.strip().startswith("http://127.0.0.1:6006/")
