"""What is demanded of a fuzzed study: an answer that is finite, in range and the same again, or one line."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from vocc_torch.app.config import AppConfig, keys_of, register_schema
from vocc_torch.app.resolve import one_line, resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.sweep import group_of
from vocc_torch.measure.train import train
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.receiver.flda import FLDAWarning

BASE = (
    "experiment=scenes",
    "device=cpu",
    "budget.frames=4",
    "budget.training_frames=4",
)
"""The command line that a case changes."""

ABOUT_TRAINING = ("training found no panel in any of", "FLDA has seen no ")
"""Refusals of training, which name what was found and not a key."""


ROUNDING = {
    torch.uint8: (0.0, 0.0),
    torch.float32: (1e-6, 1e-5),
    torch.float64: (1e-13, 1e-5),
}
"""How far what is read of frames may lie apart in two batches, by the frames' kind: as a share, or as it is.

Gamma's slope at black is infinite: 1e-16 of the light that should not be there is 1e-5 of a grey level.
"""


class DefectError(Exception):
    """An answer, or a refusal, that must not be."""


@dataclass(frozen=True)
class Outcome:
    """How a case ended: ``answered``, with what was seen, or ``refused``, with the line."""

    kind: str
    line: str = ""
    found: int = 0
    frames: int = 0


@functools.cache
def _paper_words():
    """The configuration as the command line composes it when nothing is overridden, as plain values."""
    GlobalHydra.instance().clear()
    register_schema()
    GlobalHydra.instance().clear()  # another module may have left its own
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        return OmegaConf.to_container(
            compose("config", overrides=list(BASE)), resolve=True
        )


@functools.cache
def paper_flda():
    """A discriminant trained once on the paper's scenes."""
    plain = copy.deepcopy(_paper_words())
    plain["receiver"]["locator"], plain["budget"]["training_frames"] = "truth", 256
    return train(build_plan(resolved(OmegaConf.create(plain)), Path("runs/none"))).flda


def settings_of(case):
    """Put a case's values into the configuration."""
    plain = copy.deepcopy(_paper_words())
    for key, value in case.changes.items():
        *parents, name = key.split(".")
        owner = functools.reduce(dict.__getitem__, parents, plain)
        assert name in owner, key
        owner[name] = copy.deepcopy(value)
    return resolved(OmegaConf.create(plain))


def run(case):
    """Run a case and demand what is demanded.

    Raises:
        DefectError: it is not given, with the reason.
    """
    with warnings.catch_warnings(), np.errstate(all="raise", under="ignore"):
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", FLDAWarning)
        try:
            return _run(case)
        except DefectError:
            raise
        except VoccError as error:
            check_line(str(error))
            return Outcome("refused", str(error))
        except Exception as error:
            where = error.__traceback__
            while where.tb_next is not None:
                where = where.tb_next
            code = where.tb_frame.f_code
            place = f"{Path(code.co_filename).name}:{code.co_name}"
            said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise DefectError(f"crash in {place}: {said}") from error


def _run(case):
    settings = settings_of(case)
    plan = build_plan(settings, Path("runs/none"))
    flda = train(plan).flda if case.trains else paper_flda()
    bank = ReceiverBank(plan.receiver.names, flda)
    first = _seen(plan, bank, plan.batch_frames, case.frames)
    alone = min(plan.batch_frames, case.frames) > 1
    again = _seen(plan, bank, 1 if alone else case.frames, 1 if alone else case.frames)
    for name, value in first.items():
        _check(name, value, plan)
        _compare(
            name, value[: len(again[name])], again[name], ROUNDING[first["grey"].dtype]
        )
    return Outcome("answered", "", int(first["found"].sum()), case.frames)


def _seen(plan, bank, batch_frames, frames):
    """Render, locate, read and decide; every tensor that comes of it, by name."""
    link = Link.of(dataclasses.replace(plan, batch_frames=batch_frames))
    model = plan.experiment.model_at(plan.world, plan.experiment.values[0])
    keys = block_keys(plan.seed, "fuzz", frames)
    preambles = needs_preambles(plan.receiver.names)
    parts = []
    for seen in link.observe(model, keys, preambles=preambles, frames=frames):
        part = {
            "grey": seen.frames.grey,
            "origin": seen.frames.origin_px,
            "corners": seen.panels.corners_px,
            "found": seen.panels.found,
            "panel score": seen.panels.score,
            "candidates": seen.panels.candidates,
            "features": seen.readings.features,
            "average grey": seen.readings.greys.average,
            "centre grey": seen.readings.greys.centre,
            "contrast": link.simulator.contrast(seen.scene),
            "group": group_of(plan.experiment, link, seen),
        }
        if seen.frames.surround is not None:
            part["surround"] = seen.frames.surround
        for name, scores in bank.scores(seen.readings, seen.preambles).items():
            part[f"score {name}"] = scores
        parts.append(part)
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _compare(name, one, other, rounding):
    """Demand that another batch gives the same, to the last bit with frames of 8 bits, else to rounding.

    Torch adds in an order that the batch decides, which shows in frames that were never rounded.
    """
    if one.dtype == other.dtype and torch.equal(one, other):
        return
    if one.shape != other.shape or not torch.allclose(
        one, other, rtol=rounding[0], atol=rounding[1]
    ):
        apart = (
            float((one.double() - other.double()).abs().max())
            if one.shape == other.shape
            else math.inf
        )
        raise DefectError(f"{name} differs in another batch, by {apart:.1e}")


def _check(name, value, plan):
    """Demand that one tensor is finite and in its range."""
    if value.is_floating_point() and not bool(value.isfinite().all()):
        held = "NaN" if bool(value.isnan().any()) else "infinite"
        raise DefectError(f"{name} is {held}")
    if name in ("grey", "surround", "average grey", "centre grey"):
        bounded = "saturation" in plan.world.effects
        low, high = float(value.min()), float(value.max())
        if low < 0 or (bounded and high > 255):
            raise DefectError(f"{name} is {low:g} to {high:g}")
    if name == "panel score" and not bool(((value >= 0) & (value <= 1)).all()):
        raise DefectError(f"{name} is {float(value.min()):g} to {float(value.max()):g}")


def check_line(line):
    """Demand that a refusal is one short line that names a key and says what holds.

    Raises:
        DefectError: it is not.
    """
    if line.count("\n") or len(line) > 2000:
        raise DefectError(f"refusal is not one line: {line[:400]!r}")
    if line.startswith(ABOUT_TRAINING):
        return
    key = re.match(r"[a-z_0-9.]+", line)
    known = key is not None and (
        key.group().rstrip(".") in keys() or key.group().startswith("scene.effects.")
    )
    if not known or not re.search(r"\d|is |has |needs |refers |ends ", line):
        raise DefectError(f"refusal names no key: {line}")


@functools.cache
def keys():
    """Every key that a refusal may name."""
    scene = [
        f"{section}.{name}"
        for section in ("experiment.scene", "experiment.training")
        for name in _paper_words()["scene"]
    ]
    return {*keys_of(AppConfig), *scene}


def first_words(line):
    """The part of a refusal that is alike for all values."""
    return re.sub(r"[-+]?\b(\d+\.?\d*(e[-+]?\d+)?|inf|nan)\b", "N", line).split(" is ")[
        0
    ][:60]


def say(words):
    """Put words behind the command, in this process, and give the complaint, or None where there is none.

    Raises:
        DefectError: anything but a complaint of one line.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            line = _complaint(words)
        except Exception as error:
            raise DefectError(f"crash: {type(error).__name__}: {error}") from error
    if line is not None and ("\n" in line or not line.strip()):
        raise DefectError(f"complaint is not one line: {line[:400]!r}")
    return line


def _complaint(words):
    """Do what the command does with its words, up to the plan."""
    GlobalHydra.instance().clear()
    register_schema()
    GlobalHydra.instance().clear()  # another module may have left its own
    with initialize_config_module("vocc_torch.conf", version_base="1.3"):
        try:
            settings = resolved(compose("config", overrides=list(words)), words)
            build_plan(settings, Path("runs/none"))
        except VoccError as error:
            return str(error)
        except (
            HydraException,
            OmegaConfBaseException,
            ValueError,
            TypeError,
            OverflowError,
        ) as error:
            return one_line(error, words)
    return None
