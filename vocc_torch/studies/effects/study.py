"""Bit error rates with and without each effect, on the same frames, and over its severity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.tally import tallies
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.studies.effects.catalogue import Comparison, Effects, built_effects, group_of
from vocc_torch.studies.effects.costs import Costs, Kind
from vocc_torch.studies.effects.errors import FrameErrors, Piece, read_piece
from vocc_torch.studies.effects.plan import EffectStudy, Key, fills
from vocc_torch.studies.effects.table import Change, EffectRow, EffectTable, SeverityCurve, SeverityPoint

R = TypeVar("R")

Told = Callable[[str, int], None]
"""Called with what is under way and the frames done since the last call."""


@dataclass(frozen=True)
class EffectResults:
    """What came of a study of effects.

    Args:
        table: every effect one at a time, and all together.
        severities: bit error rate over severity, in physical order.
    """

    table: EffectTable
    severities: tuple[SeverityCurve, ...]


@dataclass
class _Wanted:
    """A scene that is read with one locator, by receivers that trained on some scenes."""

    effects: Effects
    locator: Locator
    frames: int = 0
    trained_on: dict[Key, Effects] = field(default_factory=dict)


_Read = Mapping[tuple[Key, Locator], FrameErrors]


def run_effects(
    study: EffectStudy, costs: Costs, workers: Workers, told: Told | None = None
) -> EffectResults:
    """Train on every scene, read every scene's test frames, and compare.

    Args:
        study: the study.
        costs: the times, measured before, while no worker was at work.
        workers: who does it.
        told: hears of frames as they are done.

    Raises:
        VoccError: no panel in any training frame, or a worker that was ended from outside.
    """
    wanted = _wanted(study)
    with worker_losses_told():
        fldas = _train(study, wanted, costs, workers, told)
        read = _read(study, wanted, fldas, workers, told)
    rows = tuple(_row(study, one, costs, read) for one in study.comparisons)
    together = None if study.together is None else _row(study, study.together, costs, read)
    base = built_effects(study.catalogue.scene)
    locators: list[Locator] = ["truth", "paper"]
    table = EffectTable(
        study.scene_name,
        rows,
        together,
        costs.times["near", base],
        costs.times["located", base],
        costs.times["whole", base],
        {
            name: _counts(study, read[base, name], base, study.frames_with(name, study.catalogue.scene))
            for name in locators
            if (base, name) in read
        },
        study.plan.receiver.names,
        study.shown,
        study.plan.budget.training_frames,
        costs.machine,
        costs.waited_share,
        costs.frames_a_call,
    )
    return EffectResults(table, tuple(_curve(study, name, read) for name in study.severities))


def frames_to_do(study: EffectStudy) -> int:
    """Count the training and test frames of a study, for a progress bar."""
    wanted = _wanted(study)
    trained = {(key, one.locator) for one in wanted.values() for key in one.trained_on}
    return len(trained) * study.plan.budget.training_frames + sum(one.frames for one in wanted.values())


def _wanted(study: EffectStudy) -> dict[tuple[Key, Locator], _Wanted]:
    """List what is read, each scene once; slow ones first, so that no worker ends long after the others."""
    wanted: dict[tuple[Key, Locator], _Wanted] = {}

    def want(effects: Effects, locator: Locator, frames: int, *trained_on: Effects) -> None:
        one = wanted.setdefault((built_effects(effects), locator), _Wanted(effects, locator))
        one.frames = max(one.frames, frames)
        one.trained_on |= {built_effects(scene): scene for scene in trained_on}

    for one in study.all_comparisons:
        for scene in (one.present, one.absent):
            if frames := study.frames_with("paper", scene):
                want(scene, "paper", frames, one.absent)
    base = study.catalogue.scene
    if frames := study.frames_with("paper", base):
        want(base, "paper", frames, base)
    want(base, "truth", study.frames_with("truth", base), base)
    for one in study.all_comparisons:
        want(one.present, "truth", study.frames_with("truth", one.present), one.absent, one.present)
        want(one.absent, "truth", study.frames_with("truth", one.absent), one.absent)
    for name, values in study.severities.items():
        compared = study.catalogue.comparison(name)
        for value in values:
            scene = study.catalogue.at(name, value)
            want(scene, "truth", study.severity_frames, compared.absent, compared.present)
    return dict(sorted(wanted.items(), key=lambda item: _slow(study, item[1]), reverse=True))


def _slow(study: EffectStudy, one: _Wanted) -> bool:
    """Whether frames are rendered whole and searched."""
    return one.locator == "paper" and fills(built_effects(one.effects))


def _train(
    study: EffectStudy,
    wanted: Mapping[tuple[Key, Locator], _Wanted],
    costs: Costs,
    workers: Workers,
    told: Told | None,
) -> dict[tuple[Key, Locator], FLDA]:
    """Train on each scene that some reading needs, with its locator; the slowest first."""
    scenes = {
        (key, one.locator): effects for one in wanted.values() for key, effects in one.trained_on.items()
    }
    kinds: dict[Locator, Kind] = {"truth": "near", "paper": "located"}

    def cost_ms(place: tuple[Key, Locator]) -> float:
        return costs.times[kinds[place[1]], place[0]].median_ms

    calls: dict[tuple[Key, Locator], Future[FLDA]] = {}
    for key, locator in sorted(scenes, key=cost_ms, reverse=True):
        call = workers.submit(_trained, study.plan_of(scenes[key, locator], locator))
        calls[key, locator] = _told(call, told, "training", study.plan.budget.training_frames)
    return {place: call.result() for place, call in calls.items()}


def _told(call: Future[R], told: Told | None, what: str, frames: int) -> Future[R]:
    """Tell of a call's frames once it is done."""
    if told is not None:
        call.add_done_callback(lambda _: told(what, frames))
    return call


def _trained(plan: Plan) -> FLDA:
    """Train on a plan's scenes."""
    return train(plan).flda.cpu()


def _read(
    study: EffectStudy,
    wanted: Mapping[tuple[Key, Locator], _Wanted],
    fldas: Mapping[tuple[Key, Locator], FLDA],
    workers: Workers,
    told: Told | None,
) -> dict[tuple[Key, Locator], FrameErrors]:
    """Read every scene's frames, piece by piece."""
    calls: dict[tuple[Key, Locator], list[Future[FrameErrors]]] = {}
    for place, one in wanted.items():
        mine = {key: fldas[key, one.locator] for key in one.trained_on}
        plan, calls[place] = study.plan_of(one.effects, one.locator), []
        step = max(1, plan.batch_frames // BLOCK_FRAMES)
        for first in range(0, -(-one.frames // BLOCK_FRAMES), step):
            frames = min(step * BLOCK_FRAMES, one.frames - first * BLOCK_FRAMES)
            blocks = tuple(range(first, first + -(-frames // BLOCK_FRAMES)))
            call = workers.submit(read_piece, Piece(plan, mine, blocks, frames))
            calls[place].append(_told(call, told, "reading", frames))
    return {place: FrameErrors.joined([call.result() for call in pieces]) for place, pieces in calls.items()}


def _row(study: EffectStudy, one: Comparison, costs: Costs, read: _Read) -> EffectRow:
    """Put one effect's results together."""
    present, absent = built_effects(one.present), built_effects(one.absent)
    changes = {
        "true_corners": _changes(study, one, read, "truth", absent),
        "retrained": _changes(study, one, read, "truth", present),
        "located": _changes(study, one, read, "paper", absent),
    }
    own = [effect for effect in present if effect.name in one.own]
    known = one.name in one.own
    return EffectRow(
        name=one.name,
        group=group_of(one.name) if known else "",
        settings=_settings(one.present, one.name) if known else "",
        own=one.own,
        companions=one.companions,
        in_scene=one.in_scene,
        fills_sensor=any(effect.fills_sensor for effect in own),
        near=costs.added("near", one),
        located=costs.added("located", one),
        whole=costs.added("whole", one),
        changes={reading: some for reading, some in changes.items() if some},
    )


def _settings(effects: Effects, name: str) -> str:
    """Write an effect's parameters as they were given."""

    def text(value: object) -> str:
        if isinstance(value, (list, tuple)):
            return f"[{', '.join(map(text, value))}]"
        return f"{value:g}" if isinstance(value, float) else str(value)

    return ", ".join(f"{parameter}={text(value)}" for parameter, value in effects[name].items())


def _changes(
    study: EffectStudy, one: Comparison, read: _Read, locator: Locator, trained_on: Key
) -> dict[str, Change]:
    """Compare a scene with the one without the effect, by receiver; nothing where no frame was read."""
    present, absent = built_effects(one.present), built_effects(one.absent)
    if (present, locator) not in read:
        return {}
    seen, other = read[present, locator], read[absent, locator]
    frames = min(study.frames_with(locator, effects) for effects in (one.present, one.absent))
    leds = study.plan.world.panel.shape.leds
    return {
        name: Change.of(
            seen.halves[trained_on][row, :frames],
            other.halves[absent][row, :frames],
            seen.found[:frames],
            other.found[:frames],
            leds,
            located=locator != "truth",
        )
        for row, name in enumerate(study.plan.receiver.names)
    }


def _counts(study: EffectStudy, seen: FrameErrors, trained_on: Key, frames: int) -> dict[str, Counts]:
    """Count the errors in the first frames, by receiver."""
    halves: NDArray[np.int64] = seen.halves[trained_on][:, :frames]
    found = np.broadcast_to(seen.found[:frames], halves.shape)
    counts, _ = tallies(halves, study.plan.world.panel.shape.leds, found)
    return dict(zip(study.plan.receiver.names, counts, strict=True))


def _curve(study: EffectStudy, name: str, read: _Read) -> SeverityCurve:
    """Put one effect's severities together."""
    compared = study.catalogue.comparison(name)
    trained = {
        "true_corners": built_effects(compared.absent),
        "retrained": built_effects(compared.present),
    }
    points = []
    for value in study.severities[name]:
        seen = read[built_effects(study.catalogue.at(name, value)), "truth"]
        errors = {
            reading: _counts(study, seen, key, study.severity_frames) for reading, key in trained.items()
        }
        points.append(SeverityPoint(float(value), errors))
    usual = study.catalogue.usual(name)
    number = float(usual) if isinstance(usual, int | float) else None
    return SeverityCurve(name, study.catalogue.severities[name].parameter, tuple(points), number)
