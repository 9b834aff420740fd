"""How bytes become symbols: what sender and receiver must agree on; nothing here needs torch."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import yaml

from vocc_torch.errors import (
    VoccError,
    demand_kind,
    demand_ranges,
    demand_word,
    finite_number,
    within,
)
from vocc_torch.hardware import PanelShape
from vocc_torch.yaml_text import read_yaml

CODES = ("rs", "ldpc", "none")
ORDERS = {2**order: order for order in range(5, 9)}
"""Symbols of a block, and how many sync bits in a row tell where in the block they stand."""


@dataclass
class Signalling:
    """How a message is written on the panel, symbol by symbol.

    Args:
        symbol_rate_hz: symbols per second, above 0 to 1e6.
        code: ``rs`` (Reed-Solomon), ``ldpc`` (5G LDPC on soft values) or ``none``.
        code_rate: information bits over all bits of a packet, above 0 and below 1; unused with ``none``.
        block_symbols: length of a symbol block: 32, 64, 128 or 256 symbols. Packets are spread within it.
        bands: bands of rows, each with a clock cell, 1 to the panel's rows.
        sync_cells: known cells that mark a symbol's place in its symbol block, at least 1.
        anchors: keep the four corner LEDs On, for location.
        interleave: spread each packet over its symbol block and over the panel.
        scramble: scramble packets, so that any text has random transitions.

    Raises:
        VoccError: a value out of its range.
    """

    symbol_rate_hz: float = within(0, 1e6, above=True, default=100.0)
    code: str = "rs"
    code_rate: float = 0.7
    block_symbols: int = 128
    bands: int = within(1, 1024, default=4, whole=True)
    sync_cells: int = within(1, 1024, default=2, whole=True)
    anchors: bool = True
    interleave: bool = True
    scramble: bool = True

    def __post_init__(self) -> None:
        """Check what can be checked without the panel's shape."""
        demand_ranges("transmit", self)
        code_rate = finite_number("transmit.code_rate", self.code_rate)
        if not 0 < code_rate < 1:
            raise VoccError.of(
                "transmit.code_rate", f"{code_rate:g}", "above 0 and below 1"
            )
        demand_word("transmit.code", self.code, CODES)
        if self.block_symbols not in ORDERS:
            raise VoccError.of(
                "transmit.block_symbols", self.block_symbols, "32, 64, 128 or 256"
            )
        for name in ("anchors", "interleave", "scramble"):
            demand_kind(f"transmit.{name}", getattr(self, name), bool)


FIELDS = tuple(attribute.name for attribute in fields(Signalling))
"""The options by name."""


@dataclass(frozen=True)
class MessagePlan:
    """What a receiver must know: the panel's shape and how the message is written on it.

    Args:
        shape: rows and columns of the panel.
        signalling: the rest.
    """

    shape: PanelShape
    signalling: Signalling

    @property
    def text(self) -> str:
        """The plan as YAML."""
        about = asdict(self.shape) | asdict(self.signalling)
        return str(yaml.safe_dump(about, sort_keys=False))

    @classmethod
    def read(cls, path: Path) -> "MessagePlan":
        """Read the plan of a file, as :attr:`text` wrote it.

        Raises:
            VoccError: no such file, keys that are missing or unknown, or values out of their range.
        """
        content, known = read_yaml(path, "plan"), {"rows", "columns", *FIELDS}
        if not isinstance(content, dict) or {*content} != known:
            raise VoccError(
                f"plan {path} is no plan of task=transmit: it must have {', '.join(sorted(known))}"
            )
        try:
            shape = PanelShape(content.pop("rows"), content.pop("columns"))
            return cls(shape, Signalling(**content))
        except (VoccError, TypeError) as error:
            raise VoccError(f"plan {path}: {error}") from None
