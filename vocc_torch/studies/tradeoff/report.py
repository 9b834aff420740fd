"""The price list in words and tables: ``recommendation.txt``, ``tradeoff.csv``, terminal and TensorBoard."""

import textwrap
from collections.abc import Iterator
from dataclasses import asdict, astuple
from pathlib import Path

from vocc_torch.measure import estimate, plan, stage_times
from vocc_torch.report import page, styles, terminal, timing_figure
from vocc_torch.report.folder import write_rows
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.prices import Place, PriceList, most_accurate

LOCATED_BY = styles.Words(
    truth="true corners", paper="paper's locator", refined="refined locator"
)

RANKS = {
    "frontier": "on the frontier",
    "perhaps": "beaten, perhaps by chance",
    "beaten": "surely beaten",
}

Line = dict[str, str | int | float | None]
"""Cells by their columns."""

COLUMNS = {
    **{
        "": 0,
        "receiver": 0,
        "locator": 0,
        "other": 0,
        "ms": 0,
        "alone\nms": 0,
        "BER": 0,
        "95 %": 96,
    },
    **{"batch": 112, "training\ns": 112, "weights": 112},
}
"""Columns on the terminal, and the least width at which they stand there."""

BOARD_COSTS = ("training_s", "parameters", "size_bytes")
"""What TensorBoard shows of the making of a receiver."""

WIDTH_WITH_TITLES = 146
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
    texts = {
        "receiver_text": receiver_text,
        "varied_text": varied_text,
        "ms": timing_figure.number_text,
    }
    given: dict[str, object] = {
        "located_by": LOCATED_BY,
        "most_accurate": most_accurate,
        "ranks": RANKS,
    }
    given["apart"] = max(abs(ratio - 1) for ratio in prices.end_to_end.values())
    given["pairs"] = estimate.all_pairs(len(prices.settings))
    lines = []
    for line in written("recommendation.txt.j2", prices, **texts, **given).splitlines():
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
    return (
        name if title.lower() == name.replace("_", " ").lower() else f"{name} ({title})"
    )


def varied_text(setting: Setting, base: Setting) -> list[str]:
    """Name what a setting varies.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> varied_text(Setting("flda_3", "paper", 8, "central", "float32"), base)
        ['central gradient']
    """
    written = {"samples_per_led": "K {}", "gradient": "{} gradient", "dtype": "{}"}
    own = {name: getattr(setting, name) for name in written}
    return [
        written[name].format(value)
        for name, value in own.items()
        if value != getattr(base, name)
    ]


def write_prices(path: str | Path, prices: PriceList) -> None:
    """Write a line for each setting and place, and blank ones for devices that are not there.

    Numbers have five digits, more than any time or rate has.

    Raises:
        VoccError: the file cannot be written.
    """

    def cell(value: str | int | float | None) -> str | int | None:
        return f"{float(f'{value:.5g}'):.15g}" if isinstance(value, float) else value

    rows = list(price_rows(prices))
    write_rows(
        path, [list(rows[0]), *(list(map(cell, map(row.get, rows[0]))) for row in rows)]
    )


def price_rows(prices: PriceList) -> Iterator[Line]:
    """Lines of ``tradeoff.csv`` by column, some columns for each kind of scenes.

    Times are ms a frame, medians over the rounds with lower and upper quartile, on frames of
    ``timed_scenes``. Stages are added round by round: their medians make up the total's but for chance.
    ``preambles_ms`` is reading and measuring the frames of known bits that a threshold comes from.
    ``share_of_detection`` is bit detection's time over panel detection's, as in the paper's Fig. 25.
    ``frontier`` compares receivers with the same batch size, ``frontier_of_best_batches`` each with its own
    best one. ``surely_beaten`` marks those whose rate is higher than that of ``beaten_by``, which is no
    slower by the median, by paired intervals of all pairs that hold together at 95 % (Bonferroni).
    ``possible_ber`` is the rate of a decoder that knows the scene on the first ``possible_test_frames`` of
    the same frames, and ``ber_on_possible_frames`` the line's own rate on these: compare the two. In
    ``possible_proven_frames`` of them no bits can be likelier than those that the decoder gave.
    ``onnx_ms``, where it was asked for, is the time of the receiver's ONNX graph in onnxruntime, in the same
    rounds and at the true corners: what ``rectify_ms``, ``features_ms`` and ``classify_ms`` do together.
    ``end_to_end`` is the time of ``end_to_end_of`` in one go over the sum of its stages. After several
    trainings counts and ``ber`` are the first one's, what beats what is judged over all of them, and the last
    columns have the algorithm's rate.
    """
    error_device = str(plan.resolve_device(prices.study.plan.world.device))
    for place in prices.places:
        points = {scenes: prices.points(scenes, *place) for scenes in prices.errors}
        best = {
            scenes: prices.points(scenes, place.device, place.frames)
            for scenes in prices.errors
        }
        for row, setting in enumerate(prices.settings):
            times = prices.times[setting, place]
            in_best = best[prices.timed_scenes][row].place == place
            line: Line = {**asdict(setting), **place._asdict(), "rounds": times.rounds}
            line |= {"best_batch": int(in_best), **_ends("total{}_ms", times.total)}
            for stage in stage_times.STAGES:
                line |= _ends(f"{stage}{{}}_ms", times.stage(stage))
            line |= {
                "frames_per_s": 1e3 / times.total.value,
                **_ends("share_of_detection{}", times.share),
            }
            for scenes, own in points.items():
                point, mark, same = (
                    own[row],
                    prices.references.get(scenes),
                    own[row].referenced,
                )
                counts, kept = point.counts, best[scenes][row].rank == "frontier"
                cells: Line = {
                    "test_frames": counts.frames,
                    "bit_errors": f"{counts.bit_errors:.15g}",
                }
                cells |= {
                    "frame_errors": counts.frame_errors,
                    "panels_missed": counts.panels_missed,
                }
                cells |= {
                    **_ends("ber{}", point.ber),
                    "frontier": int(point.rank == "frontier"),
                }
                beaten_by = point.beaten_by.name if point.beaten_by else ""
                cells |= {"beaten_by": beaten_by, "surely_beaten": int(point.surely)}
                cells |= {"frontier_of_best_batches": int(kept) if in_best else None}
                known = (
                    (mark.counts.frames, mark.proven, 1e3 * mark.seconds_a_frame)
                    if mark
                    else (None,) * 3
                )
                names = (
                    "possible_test_frames",
                    "possible_proven_frames",
                    "possible_frame_ms",
                )
                cells |= zip(names, known, strict=True)
                cells |= _ends("possible_ber{}", prices.reference(scenes))
                cells["ber_on_possible_frames"] = same.ber if same else None
                # The first training's, as everywhere in a table; the algorithm's stand at the end.
                cells |= _ends("ber{}", prices.of_first_training.rate(scenes, row))
                line |= {f"{scenes}_{name}": cell for name, cell in cells.items()}
            made = (
                "training_s",
                "training_simulated_s",
                "training_frames",
                "parameters",
                "size_bytes",
            )
            line |= zip(made, astuple(prices.costs[setting]), strict=True)
            line |= {"timed_scenes": prices.timed_scenes, "error_device": error_device}
            line |= {
                "end_to_end": prices.end_to_end[place],
                "end_to_end_of": prices.in_one_go,
            }
            line |= {
                "threads": prices.threads,
                "waited_share": round(prices.waited_share, 4),
            }
            line |= {"machine": prices.machines[place.device]}
            if prices.graphs or prices.no_graphs:
                line |= _ends("onnx{}_ms", prices.graph_of(setting, place))
            if prices.algorithms:
                line["trainings"] = prices.study.plan.budget.trainings
                for scenes, of in prices.algorithms.items():
                    rate, spread = prices.rate(scenes, row), of.trained(row).deviation
                    ends = {"ber_mean": rate.value, "ber_sd": spread}
                    ends |= {"algorithm_low": rate.low, "algorithm_high": rate.high}
                    line |= {f"{scenes}_{name}": value for name, value in ends.items()}
            yield line
    for device in prices.study.missing:
        for place in dict.fromkeys(
            place._replace(device=device) for place in prices.places
        ):
            for setting in prices.settings:
                yield {**asdict(setting), **place._asdict(), "machine": "not measured"}


def _ends(name: str, one: estimate.Estimate | None) -> Line:
    """Name a number and the ends of its interval."""
    values = (None, None, None) if one is None else (one.value, one.low, one.high)
    return {
        name.format(part): value
        for part, value in zip(("", "_low", "_high"), values, strict=True)
    }


def print_prices(prices: PriceList, words: str, console: terminal.Console) -> None:
    """Print the first kind of frames and scenes, the quickest receiver first, and what to take of it.

    Args:
        prices: what was measured.
        words: the recommendation, of which the short part is printed.
        console: where to print.
    """
    (device, frames), scenes, width = (
        prices.kinds[0],
        prices.timed_scenes,
        console.width,
    )
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    points, rate = prices.points(scenes, device, frames), prices.reference(scenes)
    rows: list[tuple[Line, str]] = []
    for point in sorted(points, key=lambda one: one.ms):
        setting, first, cost = (
            point.setting,
            point.rank == "frontier",
            prices.costs[point.setting],
        )
        named = (
            receiver_text(setting.receiver)
            if width >= WIDTH_WITH_TITLES
            else setting.receiver
        )
        varied = ", ".join(varied_text(setting, prices.settings[0])).replace(
            " gradient", ""
        )
        line: Line = {
            "": mark if first else "",
            "receiver": named,
            "locator": setting.locator,
        }
        line |= {
            "other": varied,
            "ms": timing_figure.number_text(point.ms),
            **_rate(point.ber),
        }
        trained = f"{cost.training_s:.1f}" if cost.frames else None
        line |= {
            "batch": point.place.batch,
            "training\ns": trained,
            "weights": cost.parameters,
        }
        if alone := prices.times.get((setting, Place(device, frames, 1))):
            line["alone\nms"] = timing_figure.number_text(alone.total.value)
        rows.append((line, "" if first else "dim"))
    best = most_accurate(points)
    if rate is not None and best is not None and best.referenced is not None:
        same = f"{best.referenced.frames} frames"
        told = (
            styles.rate_text(best.referenced.ber)
            if best.referenced.bit_errors
            else "no error"
        )
        rows.append(({"receiver": "knows the scene", "other": same, **_rate(rate)}, ""))
        who: Line = {"receiver": best.setting.receiver, "locator": best.setting.locator}
        rows.append(({**who, "other": f"same {same}", "BER": told}, ""))
    shown = [
        head for head, least in COLUMNS.items() if width >= least and head in rows[0][0]
    ]
    table = terminal.plain_table(*(head.replace("other", "") for head in shown))
    for column in table.columns[:4]:
        column.justify = "left"
    for line, style in rows:
        texts = ("" if line.get(head) is None else str(line[head]) for head in shown)
        table.add_row(*map(terminal.Text, texts), style=style)
    console.print(table)
    below = written("table.txt.j2", prices, mark=mark, scenes=scenes, frames=frames)
    console.print(terminal.Text(below.rstrip()))
    console.print(
        terminal.Text(words.partition("EVERY KIND OF")[0].rstrip()), soft_wrap=True
    )


def _rate(ber: estimate.Estimate) -> Line:
    """Write a rate and its interval, or its limit."""
    if ber.value == 0:
        return {"BER": f"< {styles.rate_text(ber.high)}", "95 %": ""}
    return {
        "BER": styles.rate_text(ber.value),
        "95 %": styles.ends_text(ber.low, ber.high),
    }


def price_runs(
    prices: PriceList,
) -> dict[str, tuple[dict[str, object], dict[str, float]]]:
    """Give TensorBoard a run for each configuration: its settings, and rates, times and training cost."""
    numbers: dict[Setting, dict[str, float]] = {
        setting: {} for setting in prices.settings
    }
    for device, frames in prices.kinds:
        where = frames if len(prices.machines) == 1 else f"{device}_{frames}"
        for scenes in prices.errors:
            for point in prices.points(scenes, device, frames):
                own = numbers[point.setting]
                own |= {f"ber/{scenes}": point.counts.ber, f"ms/{where}": point.ms}
                if alone := prices.times.get((point.setting, Place(device, frames, 1))):
                    own[f"latency_ms/{where}"] = alone.total.value
    for setting, own in numbers.items():
        made = {name: getattr(prices.costs[setting], name) for name in BOARD_COSTS}
        own |= {
            f"making/{name}": float(one)
            for name, one in made.items()
            if one is not None
        }
    return {setting.name: (asdict(setting), own) for setting, own in numbers.items()}
