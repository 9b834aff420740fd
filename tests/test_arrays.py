"""NumPy files of one plain array: whatever the header says, a value or one line."""

import io
import struct

import numpy as np
import pytest

from vocc_torch.arrays import read_npy
from vocc_torch.errors import VoccError

SHAPES = {
    "true": "(True, 8, 8)",
    "negative": "(-1, 8, 8)",
    "beyond the file": f"({2**40}, 8, 8)",
    "beyond 64 bits": f"({2**70}, 8, 8)",
    "5000 digits": f"({'9' * 5000}, 8, 8)",
    "a list": "[1, 8, 8]",
    "nested": "[" * 4000,
    "a call": "__import__('os').system('false')",
}


def with_shape(shape):
    head = f"{{'descr': '|b1', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head + b"\1" * 64


def test_an_array_is_read_as_numpy_reads_it(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(with_shape("(1, 8, 8)"))
    read = read_npy(path, "input")
    assert np.array_equal(read, np.load(path))
    assert read.dtype == np.bool_


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_header_that_no_array_has_is_one_line(tmp_path, shape):
    path = tmp_path / "a.npy"
    path.write_bytes(with_shape(shape))
    with pytest.raises(VoccError, match=r"^input .*a\.npy cannot be read") as error:
        read_npy(path, "input")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_an_archive_and_an_empty_file_are_no_array(tmp_path):
    archive = io.BytesIO()
    np.savez(archive, a=np.ones(2))
    for content in (archive.getvalue(), b""):
        (tmp_path / "a.npy").write_bytes(content)
        with pytest.raises(VoccError, match="as one array"):
            read_npy(tmp_path / "a.npy", "input")
