"""``task=tradeoff``: what accuracy costs in time, as a picture, a table and words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import as_markdown, print_place, refuse_results, refuse_unused, write_config
from vocc_torch.show.quiet import quiet_threads
from vocc_torch.show.stopwatch import Stopwatch
from vocc_torch.studies.paper.evidence.timing import PAPER_SHARES
from vocc_torch.studies.tradeoff.build import build_tradeoff_study
from vocc_torch.studies.tradeoff.config import TradeoffConfig
from vocc_torch.studies.tradeoff.knob_setting import KnobSetting
from vocc_torch.studies.tradeoff.plan import TradeoffStudy
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.renderer import price_renderer
from vocc_torch.studies.tradeoff.study import price_receivers
from vocc_torch.studies.tradeoff.tradeoff_advice import recommendation
from vocc_torch.studies.tradeoff.tradeoff_csv import write_prices, write_renderer
from vocc_torch.studies.tradeoff.tradeoff_figure import tradeoff_figure
from vocc_torch.studies.tradeoff.tradeoff_shares import shares_figure
from vocc_torch.studies.tradeoff.tradeoff_table import print_prices, print_renderer


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers and renderer, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder)
    study, console = build_tradeoff_study(settings, config, folder), Console()
    prices, knobs = _measure(study, Workers(settings.workers), console)
    figures = _figures(prices)
    _write(settings, prices, knobs, figures, folder)
    print_prices(prices, console)
    if knobs:
        print_renderer(knobs, console)
    _print_places(console, settings, knobs, folder)


def _measure(study: TradeoffStudy, workers: Workers, console: Console) -> tuple[PriceList, list[KnobSetting]]:
    """Measure all there is, and say how long it took."""
    watch = Stopwatch()
    with console.status("starting") as status:

        def told(stage: str) -> None:
            status.update(stage)

        with watch.stage("receivers"):
            prices = price_receivers(study, workers, told)
        told("renderer")
        with watch.stage("renderer"):
            knobs = price_renderer(study)
    for name, seconds in watch.seconds.items():
        console.print(f"{name:<12} {seconds:6.1f} s", highlight=False)
    return prices, knobs


def _figures(prices: PriceList) -> dict[str, Figure]:
    """Draw a picture for each kind of scenes, frames and device, the main one first, and Fig. 25."""
    figures: dict[str, Figure] = {}
    for scenes in prices.errors:
        for device, frames in prices.kinds:
            parts = [frames, scenes, *([device.replace(":", "")] if len(prices.machines) > 1 else [])]
            name = "-".join(["tradeoff", *parts]) if figures else "tradeoff"
            figures[name] = tradeoff_figure(prices, scenes, device, frames)
    shares = shares_figure(prices, PAPER_SHARES)
    return figures if shares is None else {**figures, "fig25": shares}


def _write(
    settings: Settings,
    prices: PriceList,
    knobs: Sequence[KnobSetting],
    figures: dict[str, Figure],
    folder: Path,
) -> None:
    """Write tables, pictures, words and the board."""
    write_config(settings, folder)
    write_prices(folder / "tradeoff.csv", prices)
    if knobs:
        machine = next(iter(prices.machines.values()))
        write_renderer(folder / "renderer.csv", knobs, prices.threads, machine)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    words = recommendation(prices, knobs)
    write_atomically(folder / "recommendation.txt", words.encode())
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import write_boards
        from vocc_torch.studies.tradeoff.tradeoff_board import write_price_rows

        texts = {"configuration": as_markdown(settings), "recommendation": f"```\n{words}\n```"}
        with quiet_threads():
            write_boards(folder / "tensorboard", {}, figures, {}, texts)
            write_price_rows(folder / "tensorboard", prices)


def _print_places(console: Console, settings: Settings, knobs: Sequence[KnobSetting], folder: Path) -> None:
    """Say where the results are."""
    places = {"picture": "tradeoff.png", "table": "tradeoff.csv", "words": "recommendation.txt"}
    if knobs:
        places["renderer"] = "renderer.csv"
    for what, name in places.items():
        print_place(console, what, folder / name)
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import board_hint

        print_place(console, "board", board_hint(folder / "tensorboard"))
