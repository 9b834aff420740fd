"""What the working precision does to the whole link: pixels, bits and error rates, on the same frames.

Frames are simulated, panels located and LEDs read in float64, float32, bfloat16 and float16: the simulation
alone, the receiver alone, and both. Everything is compared with float64 throughout. Bits are decided by
``flda_3``, once trained in float64 and applied, once trained in the precision itself. The simulator refuses
half precision and the receiver works in float32 whatever it is given: the program goes round both, to show
what that is for.

Further rows leave the precision and change how the same float32 work is done: under ``torch.autocast``, with
convolutions as TF32 does them on a GPU (imitated: their inputs rounded to 10 bits), and compiled.

    python benchmarks/precision.py
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.files import write_atomically
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.receiver import resample
from vocc_torch.receiver.features import (
    average_greyscale_ratio,
    cell_means,
    gradient_radial_inwardness,
    neighbour_greyscale_ratio,
)
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import Distribution, SceneModel
from vocc_torch.types import Frames, Panels

SHAPE = PanelShape(8, 8)
EXACT = torch.float64
DTYPES = (torch.float64, torch.float32, torch.bfloat16, torch.float16)
LOCATORS = ("truth", "paper")
Way = tuple[torch.dtype, torch.dtype, str]
"""Precision of the simulation and of the receiver, and how the work is done."""


def only(**values: float | tuple[float, float]) -> SceneModel:
    """Narrow the training scenes to one value of a field, or to a range."""
    narrow = {
        name: Distribution("uniform", value)
        if isinstance(value, tuple)
        else Distribution("constant", (value,))
        for name, value in values.items()
    }
    return replace(SceneModel(), **narrow)


POINTS: dict[str, tuple[SceneModel, int]] = {
    "Table 1": (SceneModel(), 1024),
    "1000 lx": (only(ambient_lx=1000.0), 1024),
    "1 lx": (only(ambient_lx=1.0), 256),
    "5 m": (only(distance_m=(5.0, 5.5), offset_x_m=0.0, offset_y_m=0.0), 64),
}
"""Where the link is compared: scenes and frames. Receivers train on the first."""


def ways() -> list[Way]:
    """List what is compared, float64 throughout first."""
    pairs = [(one, EXACT) for one in DTYPES] + [(EXACT, one) for one in DTYPES[1:]]
    found = [(*pair, "eager") for pair in [*pairs, *((one, one) for one in DTYPES[1:])]]
    single = (torch.float32, torch.float32)
    return [*found, *((*single, how) for how in ("TF32", "autocast bfloat16", "autocast float16"))]


def tf32(value: Tensor) -> Tensor:
    """Round float32 to the 10 bits of mantissa that TF32 keeps, the nearest, ties away from zero."""
    if value.dtype != torch.float32:
        return value
    return ((value.contiguous().view(torch.int32) + 0x1000) & ~0x1FFF).view(torch.float32)


@contextmanager
def working(how: str) -> Iterator[None]:
    """Do float32 work in another manner."""
    plain = F.conv2d
    manners: dict[str, AbstractContextManager[object]] = {
        "TF32": mock.patch.object(
            F, "conv2d", lambda x, w, *rest, **more: plain(tf32(x), tf32(w), *rest, **more)
        ),
        "autocast bfloat16": torch.autocast("cpu", torch.bfloat16),
        "autocast float16": torch.autocast("cpu", torch.float16),
    }
    with manners.get(how, nullcontext()):
        yield


def simulator(dtype: torch.dtype) -> Simulator:
    """Build the paper's simulator in any precision."""
    built = Simulator()
    built.dtype = dtype
    return built


def read(frames: Frames, panels: Panels, dtype: torch.dtype) -> Tensor:
    """Measure the features in a precision, (B,R,C,3) float64; a panel not found is read at some square."""
    grey = frames.grey.to(dtype if dtype == EXACT else torch.float32)
    cast = Frames(grey, frames.origin_px, frames.sensor_px, frames.surround)
    # Its zero size gives a factor that float16 cannot hold.
    square = panels.corners_px.new_tensor([[0, 0], [8, 0], [8, 8], [0, 8]]) + frames.origin_px[:, None]
    corners = torch.where(panels.found[:, None, None], panels.corners_px, square)
    panels = replace(panels, corners_px=corners)
    if dtype in (torch.float32, torch.float64):
        return Reader(SHAPE).read(cast, panels).features
    return read_in_half(cast, panels, dtype)


def read_in_half(frames: Frames, panels: Panels, dtype: torch.dtype) -> Tensor:
    """Measure as the reader does, with its resampling and its features in half precision.

    Near panels cannot be read so: positions round beyond the window's end. What is given then is NaN.
    """
    sample = resample._read  # the one place where the reader's precision can be changed

    def in_half(*places: Any) -> Tensor:
        *others, x, y = places
        return sample(*others, x.to(dtype), y.to(dtype)).to(x.dtype)

    try:
        with mock.patch.object(resample, "_read", in_half):
            patches = resample.rectify(frames, panels, SHAPE, Reader(SHAPE).samples_per_led).to(dtype)
    except RuntimeError as error:
        if "out of bounds" not in str(error):
            raise
        return torch.full((len(frames), SHAPE.rows, SHAPE.columns, 3), torch.nan, dtype=torch.float64)
    means, size = cell_means(patches, SHAPE), resample.cell_size_px(panels.corners_px, SHAPE)
    gri = gradient_radial_inwardness(patches, SHAPE, *size)
    found = torch.stack([average_greyscale_ratio(means), gri, neighbour_greyscale_ratio(means)], dim=-1)
    assert found.dtype == dtype
    return found.to(torch.float64)


@dataclass
class Seen:
    """What one way made of the frames: pixels that differ, features by locator, panels found by locator."""

    pixels: int = 0
    pixels_differ: int = 0
    most_dn: int = 0
    features: dict[str, list[Tensor]] = field(default_factory=lambda: {name: [] for name in LOCATORS})
    found: dict[str, list[Tensor]] = field(default_factory=lambda: {name: [] for name in LOCATORS})

    def compare(self, frames: Frames, exact: Frames) -> None:
        """Count the pixels that differ from what they should be."""
        apart = (frames.grey.int() - exact.grey.int()).abs()
        self.pixels += apart.numel()
        self.pixels_differ += int((apart > 0).sum())
        self.most_dn = max(self.most_dn, int(apart.max()))

    def gathered(self, locator: str) -> tuple[Tensor, Tensor]:
        """Join the batches: features (B,R,C,3) and found (B,)."""
        return torch.cat(self.features[locator]), torch.cat(self.found[locator])


def blocks(point: str, model: SceneModel, frames: int) -> Iterator[tuple[Scene, Tensor]]:
    """Draw the scenes and bits of a point, a block at a time."""
    for index in range(-(-frames // BLOCK_FRAMES)):
        yield model.draw(BlockKey(0, f"precision/{point}", index), SHAPE)


def observe(
    point: str, model: SceneModel, frames: int, compared: list[Way]
) -> tuple[dict[Way, Seen], Tensor]:
    """Run the frames of a point through the link in every way."""
    seen = {way: Seen() for way in compared}
    sent = []
    for scene, bits in blocks(point, model, frames):
        sent.append(bits)
        exact = simulator(EXACT).render(scene, bits, nearest_m=model.nearest_m)
        for made, how in dict.fromkeys((made, how) for made, _, how in compared):
            with working(how):
                taken = simulator(made).render(scene, bits, nearest_m=model.nearest_m)
                truth = simulator(made).true_panels(scene)
                where = {"truth": truth, "paper": PaperLocator()(taken, SHAPE)}
                for way in (way for way in compared if (way[0], way[2]) == (made, how)):
                    seen[way].compare(taken, exact)
                    for locator, panels in where.items():
                        seen[way].features[locator].append(read(taken, panels, way[1]))
                        seen[way].found[locator].append(panels.found)
    return seen, torch.cat(sent)


def trained(seen: Seen, bits: Tensor, locator: str) -> FLDA:
    """Fit the three features of one way's training frames."""
    features, found = seen.gathered(locator)
    return FLDA(3).fit(features[found], bits[found])


def row(
    point: str, locator: str, way: Way, seen: Seen, exact: Seen, bits: Tensor, own: FLDA, fixed: FLDA
) -> dict[str, object]:
    """Compare one way's decisions with those of float64 throughout."""
    features, found = seen.gathered(locator)
    reference, reference_found = exact.gathered(locator)
    names = [str(dtype).removeprefix("torch.") for dtype in way[:2]]
    kind = {"point": point, "locator": locator, "simulation": names[0], "receiver": names[1], "how": way[2]}
    seen_px = {"pixels": seen.pixels, "pixels_differ": seen.pixels_differ, "most_dn": seen.most_dn}
    if bool(features.isnan().any()):
        return {**kind, "frames": len(found), **seen_px, "bits": bits.numel(), "bits_differ": "does not run"}
    hits, reference_hits = found.view(-1, 1, 1), reference_found.view(-1, 1, 1)
    scores, wanted_scores = fixed(features), fixed(reference)
    wanted = (wanted_scores >= 0) & reference_hits
    decided = (own(features) >= 0) & hits
    counts = Counts.of(decided, bits, found)
    interval = ber_interval(counts)
    return {
        **kind,
        "frames": len(found),
        **seen_px,
        "bits": bits.numel(),
        "bits_differ": int((((scores >= 0) & hits) != wanted).sum()),
        "bits_differ_retrained": int((decided != wanted).sum()),
        "score_differs": f"{float((scores - wanted_scores).abs().max()):.3g}",
        "ber": counts.ber,
        "ber_low": interval.low,
        "ber_high": interval.high,
        "ber_trained_in_float64": Counts.of((scores >= 0) & hits, bits, found).ber,
        "panels_missed": counts.panels_missed,
    }


def rows() -> Iterator[dict[str, object]]:
    """Compare every way at every point."""
    compared = ways()
    taught, lessons = observe("train", SceneModel(), 512, compared)
    fldas = {(way, name): trained(taught[way], lessons, name) for way in compared for name in LOCATORS}
    for point, (model, frames) in POINTS.items():
        seen, bits = observe(point, model, frames, compared)
        for locator in LOCATORS:
            for way in compared:
                own, fixed = fldas[way, locator], fldas[compared[0], locator]
                yield row(point, locator, way, seen[way], seen[compared[0]], bits, own, fixed)


def compiler() -> str | None:
    """Name the C++ compiler that torch.compile would use."""
    return next(
        (name for name in (os.environ.get("CXX", ""), "g++", "clang++") if name and shutil.which(name)), None
    )


def compiled_rows(batches: int = 4) -> Iterator[dict[str, object]]:
    """Compare eager with compiled work in float32 and float64: rendering, and reading with the decision."""
    model, exact_way = SceneModel(), (EXACT, EXACT, "eager")
    taught, lessons = observe("train", model, 512, [exact_way])
    fixed = trained(taught[exact_way], lessons, "paper")
    for dtype in (torch.float32, torch.float64):
        render: Callable[..., Frames] = torch.compile(simulator(dtype).render)
        measure: Callable[..., Tensor] = torch.compile(read)
        plain, fast, sent = Seen(), Seen(), []
        for scene, bits in list(blocks("Table 1", model, batches * BLOCK_FRAMES)):
            eager = simulator(dtype).render(scene, bits, nearest_m=model.nearest_m)
            made = render(scene, bits, nearest_m=model.nearest_m)
            for seen, frames, reading in ((plain, eager, read), (fast, made, measure)):
                panels = PaperLocator()(frames, SHAPE)
                seen.features["paper"].append(reading(frames, panels, dtype))
                seen.found["paper"].append(panels.found)
            fast.compare(made, eager)
            sent.append(bits)
        way = (dtype, dtype, "compiled")
        yield row("Table 1", "paper", way, fast, plain, torch.cat(sent), fixed, fixed)
        torch.compiler.reset()


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path("docs/results/precision.csv"))
    parser.add_argument("--eager-only", action="store_true", help="leave torch.compile out")
    args = parser.parse_args()
    torch.set_num_threads(1)
    begin, found = time.perf_counter(), []
    sources = [rows()]
    if not args.eager_only:
        if compiler():
            sources.append(compiled_rows())
        else:
            print("no C++ compiler: torch.compile is left out")
    with torch.no_grad():
        for one in (one for source in sources for one in source):
            found.append(one)
            print(" ".join(f"{name}={value}" for name, value in one.items()), flush=True)
    text = io.StringIO()
    table = csv.DictWriter(text, list(found[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(found)
    write_atomically(args.out, text.getvalue().encode())
    print(f"{args.out}: {len(found)} rows, {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
