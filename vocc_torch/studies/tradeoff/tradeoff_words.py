"""How the price list is put into words: names of receivers, times, rates and frames."""

from __future__ import annotations

import textwrap

from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.text_table import interval_text, rate_text
from vocc_torch.studies.tradeoff.frontier import Offer
from vocc_torch.studies.tradeoff.price_list import PriceList, Setting

FRAMES_PER_S = (1000, 100, 60, 30)
"""Rates of cameras, and of an industrial one that is fast: the time limits."""

RATES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Limits of the bit error rate."""

GREYSCALE_RECEIVERS = ("center_greyscale", "average_greyscale")
"""Those whose threshold comes from frames of known bits."""

_CORNERS = {"truth": "true corners", "paper": "paper's locator", "refined": "refined locator"}


def receiver_text(name: str) -> str:
    """Write a receiver's name, and its title where that says more.

    Example:
        >>> receiver_text("lmmse"), receiver_text("center_greyscale")
        ('lmmse (LMMSE equaliser)', 'center_greyscale')
    """
    title = receiver_styles([name])[name].label
    return name if title.lower() == name.replace("_", " ").lower() else f"{name} ({title})"


def setting_text(setting: Setting, base: Setting) -> str:
    """Name a setting by its receiver and locator, and by what it varies.

    Args:
        setting: what to name.
        base: what needs no telling.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> setting_text(Setting("lmmse", "refined", 4, "sobel", "float64"), base)
        'lmmse (LMMSE equaliser), refined locator, K 4, float64'
    """
    parts = (receiver_text(setting.receiver), _CORNERS[setting.locator], *varied_text(setting, base))
    return ", ".join(parts)


def varied_text(setting: Setting, base: Setting) -> list[str]:
    """Name what a setting varies.

    Example:
        >>> base = Setting("flda_3", "paper", 8, "sobel", "float32")
        >>> varied_text(Setting("flda_3", "paper", 8, "central", "float32"), base)
        ['central gradient']
    """
    said = [] if setting.samples_per_led == base.samples_per_led else [f"K {setting.samples_per_led}"]
    said += [] if setting.gradient == base.gradient else [f"{setting.gradient} gradient"]
    return said + ([] if setting.dtype == base.dtype else [setting.dtype])


def ms_text(ms: float) -> str:
    """Write a time in three digits.

    Example:
        >>> [ms_text(value) for value in (0.03333, 0.5, 1.0, 33.333, 142.2)]
        ['0.0333', '0.500', '1.00', '33.3', '142']
    """
    digits = 0 if ms >= 99.95 else 1 if ms >= 9.995 else 2 if ms >= 0.9995 else 3 if ms >= 0.09995 else 4
    return f"{ms:.{digits}f}"


def preamble_text(prices: PriceList) -> str:
    """Say what the greyscale receivers' times include."""
    served = prices.frames_a_preamble
    return f"two frames of known bits for every {'one' if served == 1 else served} of data"


def ber_text(offer: Offer) -> str:
    """Write a rate with its interval, or the limit where there were no errors.

    Example:
        >>> ber_text(Offer("a", 1, 1, 1, 6.6e-4, 4.9e-4, 1.2e-3)), ber_text(Offer("b", 1, 1, 1, 0, 0, 1e-5))
        ('BER 6.6e-4 (4.9-12e-4)', 'no error, BER < 1.0e-5')
    """
    if offer.error_free:
        return f"no error, BER < {rate_text(offer.ber_high)}"
    return f"BER {rate_text(offer.ber)} ({interval_text(offer.ber, offer.ber_low, offer.ber_high)})"


def wrapped(line: str) -> str:
    r"""Break a line at 110 characters, with what follows under its text.

    Example:
        >>> [len(part) <= 110 for part in wrapped("  " + 40 * "word ").split("\n")]
        [True, True]
    """
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(line, 110, subsequent_indent=f"{indent}  ", break_on_hyphens=False)


def frames_text(prices: PriceList, scenes: str, frames: str) -> str:
    """Say what the receiver is handed; the size of crops is known for the scenes alone that were timed."""
    if frames == "crops" and prices.crop_px == prices.sensor_px:
        return "Frames cut to the panel's surroundings, which here are whole: an effect fills the sensor"
    height, width = prices.sensor_px if frames == "whole" else prices.crop_px
    what = "Whole frames" if frames == "whole" else "Crops of the panel's surroundings"
    return what if frames == "crops" and scenes != prices.timed_scenes else f"{what}, {width} x {height} px"


def timed_text(prices: PriceList, scenes: str) -> str:
    """Say that times are those of other scenes, where they are; else nothing.

    Args:
        prices: what was measured.
        scenes: the kind of scenes that is told of.
    """
    return "" if scenes == prices.timed_scenes else f"times are those of {told_text(prices.timed_scenes)}"


def told_text(scenes: str) -> str:
    """Write the name of a kind of scenes.

    Example:
        >>> told_text("far_and_dim")
        'far and dim'
    """
    return scenes.replace("_", " ")


def scenes_text(prices: PriceList, scenes: str) -> str:
    """Name a kind of scenes."""
    return f"{prices.scene} scenes, {told_text(scenes)}".strip()
