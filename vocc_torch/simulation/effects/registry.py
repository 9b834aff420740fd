"""The known effects in physical order, and the building of just those that a scene names."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.airlight import Airlight
from vocc_torch.simulation.effects.attenuation import Attenuation
from vocc_torch.simulation.effects.background_texture import BackgroundTexture
from vocc_torch.simulation.effects.base import Effect, Quantity
from vocc_torch.simulation.effects.blooming import Blooming
from vocc_torch.simulation.effects.lamps import Lamps
from vocc_torch.simulation.effects.led_scatter import LedScatter
from vocc_torch.simulation.effects.quantization import Quantization
from vocc_torch.simulation.effects.saturation import Saturation
from vocc_torch.simulation.effects.stuck_leds import StuckLeds
from vocc_torch.simulation.effects.veiling_glare import VeilingGlare

PHYSICAL_ORDER: tuple[type[Effect], ...] = (
    StuckLeds,
    LedScatter,
    Attenuation,
    BackgroundTexture,
    Lamps,
    Airlight,
    VeilingGlare,
    Blooming,
    Saturation,
    Quantization,
)
"""Light at the LED, air, optics, sensor, encoding: the order of effects, whatever order names them."""

CAMERA_STEPS: tuple[Quantity, ...] = (
    Quantity.LED_LUMINANCE,
    Quantity.BACKGROUND,
    Quantity.UNLIT,
    Quantity.LUMINANCE,
    Quantity.EXPOSURE,
    Quantity.GREY,
)
"""The quantities that every camera passes through by itself: projection, lens, gamma encoding."""

Parameters = Mapping[str, float]


def _known(given: str, known: list[str]) -> str:
    """Say what is known, nearest name first where there is one."""
    near = difflib.get_close_matches(given, known, n=1)
    return (f"did you mean {near[0]}? " if near else "") + f"known: {', '.join(known) or 'none'}"


def build_effects(named: Mapping[str, Parameters]) -> tuple[Effect, ...]:
    """Construct the named effects, and only those, in physical order.

    Args:
        named: effect name to its parameters, in any order.

    Returns:
        The effects, ready to run.

    Raises:
        VoccError: an unknown effect or parameter, a missing or refused value, or a chain that does not fit.

    Example:
        >>> [effect.name for effect in build_effects({"saturation": {}, "blooming": {"sigma_px": 1.5}})]
        ['blooming', 'saturation']
    """
    kinds = {kind.name: kind for kind in PHYSICAL_ORDER}
    for name in named:
        if name not in kinds:
            raise VoccError(f"scene.effects.{name} is not a known effect; {_known(name, list(kinds))}")
    effects = tuple(_construct(kind, named[kind.name]) for kind in PHYSICAL_ORDER if kind.name in named)
    check_chain(effects)
    return effects


def _construct(kind: type[Effect], parameters: Parameters | None) -> Effect:
    """Construct one effect, refusing parameters that it does not have."""
    key = f"scene.effects.{kind.name}"
    if parameters is None:
        raise VoccError(f"{key} is null: give its parameters, {{}} for none, or remove it with ~{key}")
    signature = inspect.signature(kind).parameters
    for name, value in parameters.items():
        if name not in signature:
            raise VoccError(f"{key}.{name} is not a known parameter; {_known(name, list(signature))}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise VoccError(f"{key}.{name} is {value!r}: it must be a number")
    for name, parameter in signature.items():
        if parameter.default is inspect.Parameter.empty and name not in parameters:
            raise VoccError(f"{key}.{name} is missing: the effect needs it")
    return kind(**parameters)


def check_chain(effects: tuple[Effect, ...]) -> Quantity:
    """Walk the chain and give the quantity that comes out.

    Raises:
        VoccError: an effect takes a quantity that neither the camera nor an earlier effect gives.

    Example:
        >>> check_chain(build_effects({"saturation": {}})).value
        'grey value, 0 to 255'
    """
    current = CAMERA_STEPS[0]
    for effect in effects:
        while current != effect.takes:
            step = CAMERA_STEPS.index(current) + 1 if current in CAMERA_STEPS else len(CAMERA_STEPS)
            if step == len(CAMERA_STEPS):
                makers = [kind.name for kind in PHYSICAL_ORDER if kind.gives == effect.takes]
                missing = f"needs {effect.takes.value}, which scene.effects must make: {' or '.join(makers)}"
                raise VoccError(f"scene.effects.{effect.name} {missing}")
            current = CAMERA_STEPS[step]
        current = effect.gives
    return current if current not in CAMERA_STEPS else Quantity.GREY
