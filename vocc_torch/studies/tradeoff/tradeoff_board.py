"""The price list in TensorBoard: a row of the HPARAMS tab for each configuration."""

from __future__ import annotations

from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.studies.tradeoff.price_list import Place, PriceList, Setting


def write_price_rows(folder: str | Path, prices: PriceList) -> None:
    """Write a run for each configuration: its settings, rates, times and what it took to make.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        prices: what was measured.

    Raises:
        VoccError: the folder cannot be written.
    """
    try:
        for setting in prices.settings:
            with SummaryWriter(str(Path(folder) / setting.name)) as writer:
                # The run's own folder: any other would make a run more.
                writer.add_hparams(_settings(setting), _numbers(prices, setting), run_name=".")
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error


def _settings(setting: Setting) -> dict[str, str | int]:
    """Give what a configuration is."""
    return {
        "receiver": setting.receiver,
        "locator": setting.locator,
        "samples_per_led": setting.samples_per_led,
        "gradient": setting.gradient,
        "dtype": setting.dtype,
    }


def _numbers(prices: PriceList, setting: Setting) -> dict[str, float]:
    """Give what was measured."""
    numbers = {f"ber/{scenes}": prices.counts(scenes)[setting].ber for scenes in prices.errors}
    for device, frames in prices.kinds:
        where = frames if len(prices.machines) == 1 else f"{device}_{frames}"
        best = prices.best_place(setting, device, frames)
        numbers[f"ms/{where}"] = prices.spent[setting, best].total[1]
        single = Place(device, frames, 1)
        if (setting, single) in prices.spent:
            numbers[f"latency_ms/{where}"] = prices.spent[setting, single].total[1]
    made = prices.making[setting]
    numbers["making/training_s"] = made.training_s
    for name, value in (("parameters", made.parameters), ("size_bytes", made.size_bytes)):
        if value is not None:
            numbers[f"making/{name}"] = float(value)
    return numbers
