"""YAML as plain values: JSON is read as json reads it, and what multiplies or misleads is refused."""

import json
import math
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

import vocc_torch as vt
from vocc_torch.app.config import FileConfigSource
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.measure.config import read_flat
from vocc_torch.yaml_text import MOST_BYTES, MOST_LEVELS, parse_yaml, read_yaml

WORD = st.text(st.characters(codec="ascii", exclude_categories=("Cc",)), max_size=8)
SCALAR = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | WORD
)


@given(
    st.recursive(
        SCALAR,
        lambda inner: (
            st.lists(inner, max_size=4) | st.dictionaries(WORD, inner, max_size=4)
        ),
    )
)
def test_json_is_read_as_json_reads_it(value):
    """YAML 1.2 holds JSON."""
    assert parse_yaml(json.dumps(value)) == value


CORE = {
    "030": 30,
    "-7": -7,
    "1:30": "1:30",
    "1_000": "1_000",
    "0x1F": "0x1F",
    "0o17": "0o17",
    "1e-3": 1e-3,
}
CORE |= {
    "yes": "yes",
    "off": "off",
    "TRUE": True,
    "~": None,
    "": None,
    "2024-01-01": "2024-01-01",
    ".5": 0.5,
}
CORE |= {"-.inf": -math.inf, "<<": "<<", "'030'": "030"}


@pytest.mark.parametrize("text", CORE)
def test_scalars_are_those_of_the_core_schema_in_decimal(text):
    read = parse_yaml(f"a: {text}")["a"]
    assert (read, type(read)) == (CORE[text], type(CORE[text]))


BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
REFUSED = {
    "aliases that multiply": (BOMB, "alias"),
    "deep": ("[" * 500 + "]" * 500, f"more than {MOST_LEVELS} levels"),
    "deep in blocks": ("".join(f"{' ' * level}a:\n" for level in range(500)), "levels"),
    "never closed": ("[" * 500, "levels"),
    "a key written twice": (
        "distance_m: 30\ndistance_m: 50",
        "key distance_m is there twice (line 2)",
    ),
    "a key of a key": ("effects: {fog: {a: 1, a: 2}}", "key a is there twice"),
    "a key that is null": ("~: 2", "a key is null, a list or a mapping (line 1)"),
    "a tag": ("a: !!python/object:os.system {}", "could not determine a constructor"),
    "a tag of numbers": ("a: !!int '1:30'", "invalid literal"),
    "a number without end": ("a: " + "9" * 5000, "4300 digits"),
    "too large": ("#" * (MOST_BYTES + 1), "bytes, and at most"),
}
READERS = {
    "scene": vt.load_scene,
    "plan": MessagePlan.read,
    "configuration of a run": read_flat,
    "file": read_yaml,
    "option of Hydra's": lambda path: FileConfigSource(
        "own", str(path.parent)
    ).load_config(path.name),
}


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_in_a_line(tmp_path, reader, case):
    text, says = REFUSED[case]
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(VoccError) as error:
        READERS[reader](path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_waits_for_a_pipe(tmp_path, reader):
    path = tmp_path / "a.yaml"
    os.mkfifo(path)
    with pytest.raises(VoccError, match="must be an ordinary file"):
        READERS[reader](path)
