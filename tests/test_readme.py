"""Python lines of the README run as they stand."""

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_python_blocks_run_in_order(tmp_path, monkeypatch, capsys):
    """As they stand."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    assert len(blocks) == 1
    monkeypatch.chdir(tmp_path)
    exec(blocks[0], {})
    said = capsys.readouterr().out
    rates = [float(rate) for rate in re.findall(r"tensor\(([-.e\d]+)\)", said)]
    assert len(rates) == 1
    assert max(rates) < 0.03
    assert "95 %" in said
