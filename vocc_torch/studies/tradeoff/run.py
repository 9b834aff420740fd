"""``task=tradeoff``: what accuracy costs in time, as a picture, a table and words."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from vocc_torch.files import write_atomically
from vocc_torch.measure.config import Settings
from vocc_torch.measure.workers import Workers
from vocc_torch.show.canvas import save_figure
from vocc_torch.show.folder import as_markdown, print_place, refuse_results, refuse_unused, write_config
from vocc_torch.show.tensorboard import quiet_threads
from vocc_torch.show.terminal import Stopwatch
from vocc_torch.studies.tradeoff.config import TradeoffConfig
from vocc_torch.studies.tradeoff.figure import shares_figure, tradeoff_figure
from vocc_torch.studies.tradeoff.plan import build_tradeoff_study
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.study import price_receivers
from vocc_torch.studies.tradeoff.tables import print_prices, write_price_board, write_prices
from vocc_torch.studies.tradeoff.words import recommendation


def run_tradeoff(settings: Settings, config: TradeoffConfig, folder: Path) -> None:
    """Price receivers, and report it.

    Raises:
        VoccError: an unknown name, a value outside its range, or whatever a stage refuses.
    """
    refuse_unused(settings)
    refuse_results(folder)
    study, console, watch = build_tradeoff_study(settings, config, folder), Console(), Stopwatch()
    with console.status("starting") as status, watch.stage("receivers"):
        prices = price_receivers(study, Workers(settings.workers), status.update)
    console.print(f"receivers    {watch.seconds['receivers']:6.1f} s", highlight=False)
    words = recommendation(prices)
    _write(settings, prices, words, folder)
    print_prices(prices, words, console)
    for what, name in {
        "picture": "tradeoff.png",
        "table": "tradeoff.csv",
        "words": "recommendation.txt",
    }.items():
        print_place(console, what, folder / name)
    if settings.tensorboard:
        from vocc_torch.show.folder import board_hint

        print_place(console, "board", board_hint(folder / "tensorboard"))


def _write(settings: Settings, prices: PriceList, words: str, folder: Path) -> None:
    """Write table, pictures, words and the board."""
    figures = _figures(prices)
    write_config(settings, folder)
    write_prices(folder / "tradeoff.csv", prices)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    write_atomically(folder / "recommendation.txt", words.encode())
    if settings.tensorboard:
        from vocc_torch.show.tensorboard import write_boards

        texts = {"configuration": as_markdown(settings), "recommendation": f"```\n{words}\n```"}
        with quiet_threads():
            write_boards(folder / "tensorboard", {}, figures, {}, texts)
            write_price_board(folder / "tensorboard", prices)


def _figures(prices: PriceList) -> dict[str, Figure]:
    """Draw a picture for each kind of scenes, frames and device, the main one first, and Fig. 25."""
    figures: dict[str, Figure] = {}
    for scenes in prices.errors:
        for device, frames in prices.kinds:
            parts = [frames, scenes, *([device.replace(":", "")] if len(prices.times.machines) > 1 else [])]
            name = "-".join(["tradeoff", *parts]) if figures else "tradeoff"
            figures[name] = tradeoff_figure(prices, scenes, device, frames)
    shares = shares_figure(prices)
    return figures if shares is None else {**figures, "fig25": shares}
