"""The price list as tables and words."""

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from vocc_torch.measure import estimate, stage_times
from vocc_torch.report import page, styles, terminal
from vocc_torch.report.folder import Cells, write_rows
from vocc_torch.studies.compare.prices import Place, PriceList, most_accurate
from vocc_torch.studies.compare.settings import Setting

LOCATED_BY = styles.Words(
    truth="true corners", paper="paper's locator", refined="refined locator"
)

COLUMNS = (
    *("receiver", "locator", "varied", "device", "frames", "batch"),
    *("ms", "ms_low", "ms_high"),
    *("scenes", "test_frames", "ber", "ber_low", "ber_high", "rank"),
)
"""Columns of ``tradeoff.csv``: a line for each setting, place and kind of scenes.

``varied`` names what differs from the first values. ``ms`` is the median time a frame with its quartiles,
``frames`` what the receiver is handed. After several trainings ``ber`` is the algorithm's. ``rank`` compares
receivers with the same batch size: ``frontier``, ``perhaps`` beaten by chance, or surely ``beaten``.
"""

STAGE_COLUMNS = (
    *("receiver", "locator", "varied", "device", "frames", "batch"),
    *(f"{stage}_ms" for stage in stage_times.STAGES),
    *("onnx_ms", "training_s", "training_frames", "parameters", "size_bytes"),
)
"""Columns of ``stages.csv``: medians a frame, and what training took. ``onnx_ms`` is the time of the ONNX
graph, from corners to bits."""

WIDE_COLUMNS = 130
"""Least terminal width at which receivers have their titles too."""


def written(template: str, prices: PriceList, **values: object) -> str:
    """Fill in one of the study's templates.

    Args:
        template: its file.
        prices: what was measured.
        values: what it names besides.
    """
    return page.render(
        __package__, template, prices=prices, study=prices.study, **values
    )


def recommendation(prices: PriceList) -> str:
    """Write what to take: in short, then what it rests on, then for each kind of scenes and frames."""
    text = written(
        "recommendation.txt.j2",
        prices,
        receiver_text=receiver_text,
        varied_text=varied_text,
        ms=styles.number_text,
        located_by=LOCATED_BY,
        most_accurate=most_accurate,
        pairs=estimate.all_pairs(len(prices.settings)),
        apart=max(abs(ratio - 1) for ratio in prices.times.end_to_end.values()),
    )
    lines = []
    for line in text.splitlines():
        # What follows stands under a line's text.
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        lines.append(
            textwrap.fill(line, 110, subsequent_indent=indent, break_on_hyphens=False)
        )
    return "\n".join(lines).rstrip() + "\n"


def receiver_text(name: str) -> str:
    """Write a receiver's name, and its title where that says more.

    Example:
        >>> receiver_text("lmmse"), receiver_text("center_greyscale")
        ('lmmse (LMMSE equaliser)', 'center_greyscale')
    """
    title = styles.receiver_styles([name])[name].label
    same = title.lower() == name.replace("_", " ").lower()
    return name if same else f"{name} ({title})"


def varied_text(setting: Setting, base: Setting) -> list[str]:
    """Name what a setting varies.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> varied_text(Setting("flda_3", "paper", 8, "central", "float32"), base)
        ['central gradient']
    """
    templates = {"samples_per_led": "K {}", "gradient": "{} gradient", "dtype": "{}"}
    return [
        text.format(getattr(setting, name))
        for name, text in templates.items()
        if getattr(setting, name) != getattr(base, name)
    ]


def write_prices(folder: Path, prices: PriceList) -> None:
    """Write both tables.

    Raises:
        VoccError: a file cannot be written.
    """
    for name, lines in (("tradeoff", price_lines), ("stages", stage_lines)):
        rows = (list(map(five_digits, line)) for line in lines(prices))
        write_rows(folder / f"{name}.csv", rows)


def five_digits(value: str | int | float | None) -> str | int | None:
    """Round a float to five digits, more than any time or rate has."""
    return f"{float(f'{value:.5g}'):.15g}" if isinstance(value, float) else value


def setting_cells(setting: Setting, prices: PriceList) -> tuple[str, str, str]:
    """Name a setting in the first three columns."""
    varied = ", ".join(varied_text(setting, prices.settings[0]))
    return setting.receiver, setting.locator, varied


def price_lines(prices: PriceList) -> Iterator[Cells]:
    """Give the head and the lines of ``tradeoff.csv``; devices that are not there have no numbers."""
    yield COLUMNS
    for place in prices.times.places:
        for scenes in prices.errors:
            for point in prices.points(scenes, *place):
                yield (
                    *setting_cells(point.setting, prices),
                    *place,
                    *ends(point.time_ms),
                    scenes,
                    point.counts.frames,
                    *ends(point.ber),
                    point.rank,
                )
    for device in prices.study.missing:
        for setting in prices.settings:
            cells = setting_cells(setting, prices)
            yield (*cells, device, *[None] * 10, "not measured")


def ends(value: estimate.Estimate) -> tuple[float, float, float]:
    """Give an estimate's cells."""
    return value.value, value.low, value.high


def stage_lines(prices: PriceList) -> Iterator[Cells]:
    """Give the head and the lines of ``stages.csv``."""
    yield STAGE_COLUMNS
    for (setting, place), times in prices.times.stages.items():
        cost, base = prices.costs[setting], prices.settings[0]
        graph = prices.times.graphs.get((setting.receiver, place))
        if varied_text(setting, base) or setting.locator != base.locator:
            graph = None
        yield (
            *setting_cells(setting, prices),
            *place,
            *(times.stage(stage).value for stage in stage_times.STAGES),
            graph[0].value if graph else None,
            cost.training_s,
            cost.frames,
            cost.parameters,
            cost.size_bytes,
        )


def print_prices(prices: PriceList, words: str, console: terminal.Console) -> None:
    """Print the first kind of frames and scenes, the quickest receiver first, and what to take of it.

    Args:
        prices: what was measured.
        words: the recommendation, of which the short part is printed.
        console: where to print.
    """
    (device, frames), scenes = prices.times.kinds[0], prices.timed_scenes
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    heads = ("", "receiver", "locator", "other", "ms", "alone\nms", "BER", "95 %")
    table = terminal.plain_table(*heads)
    for column in table.columns[:4]:
        column.justify = "left"
    points = prices.points(scenes, device, frames)
    for point in sorted(points, key=lambda point: point.ms):
        setting, first = point.setting, point.rank == "frontier"
        name, locator, varied = setting_cells(setting, prices)
        if console.width >= WIDE_COLUMNS:
            name = receiver_text(name)
        alone = prices.times.stages.get((setting, Place(device, frames, 1)))
        cells = (
            mark if first else "",
            name,
            locator,
            varied.replace(" gradient", ""),
            styles.number_text(point.ms),
            styles.number_text(alone.total.value) if alone else "",
            *rate_texts(point.ber),
        )
        table.add_row(*map(terminal.Text, cells), style="" if first else "dim")
    console.print(table)
    below = written("table.txt.j2", prices, mark=mark, scenes=scenes, frames=frames)
    short = words.partition("EVERY KIND OF")[0]
    console.print(terminal.Text(below.rstrip()))
    console.print(terminal.Text(short.rstrip()), soft_wrap=True)


def rate_texts(rate: estimate.Estimate) -> tuple[str, str]:
    """Write a rate and its interval, or its limit.

    Example:
        >>> rate_texts(estimate.Estimate(0.0, 0.0, 1e-4))
        ('< 1.0e-4', '')
    """
    if rate.value == 0:
        return f"< {styles.rate_text(rate.high)}", ""
    return styles.rate_text(rate.value), styles.ends_text(rate.low, rate.high)


def price_runs(
    prices: PriceList,
) -> dict[str, tuple[dict[str, object], dict[str, float]]]:
    """Give TensorBoard a run for each configuration: its settings, rates, times and training cost."""
    runs: dict[str, tuple[dict[str, object], dict[str, float]]] = {}
    for setting, cost in prices.costs.items():
        numbers = {"making/training_s": cost.training_s}
        if cost.parameters is not None:
            numbers["making/parameters"] = float(cost.parameters)
        if cost.size_bytes is not None:
            numbers["making/size_bytes"] = float(cost.size_bytes)
        runs[setting.name] = asdict(setting), numbers
    for device, frames in prices.times.kinds:
        kind = frames if len(prices.times.machines) == 1 else f"{device}_{frames}"
        for scenes in prices.errors:
            for point in prices.points(scenes, device, frames):
                _, numbers = runs[point.setting.name]
                numbers[f"ber/{scenes}"] = point.counts.ber
                numbers[f"ms/{kind}"] = point.ms
    return runs
