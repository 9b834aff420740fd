"""The command line's way from words to what a task builds before it works, without running it."""

from copy import deepcopy

from hydra import compose, initialize_config_module
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser

from vocc_torch.app.config import register
from vocc_torch.app.resolve import HYDRA_ERRORS, complaint, hydra_words, resolved
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.record_task import with_panel_of
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape
from vocc_torch.measure.build import build_plan
from vocc_torch.studies.compare.classifiers import build_classifier_study
from vocc_torch.studies.compare.effect_scenes import build_effect_study
from vocc_torch.studies.compare.tradeoff import build_tradeoff_study
from vocc_torch.studies.paper.plan import plan_figures

CHOSEN = {}
"""What Hydra composed, by the choices of groups."""


def chosen(choices):
    """The configuration of some choices of groups, which Hydra composes once; a copy."""
    if choices not in CHOSEN:
        GlobalHydra.instance().clear()
        register()
        with initialize_config_module("vocc_torch.conf", version_base="1.3"):
            CHOSEN[choices] = compose("config", overrides=list(choices))
    return deepcopy(CHOSEN[choices])


def composed(*words, raw=False):
    """The settings of a command line, or its bare configuration; Hydra sets the values."""
    taken = hydra_words(words)
    config = chosen(tuple(word for word in taken if not word.startswith("++")))
    values = [word for word in taken if word.startswith("++")]
    parsed = OverridesParser.create().parse_overrides(values)
    ConfigLoaderImpl._apply_overrides_to_config(parsed, config)
    return config if raw else resolved(config, words)


def own(file, target):
    """The words for a classifier of a file."""
    return (
        "classifier=own",
        f"classifiers.own.file={file}",
        f"classifiers.own.build._target_={target}",
    )


def study_of(*words):
    """All that a task builds before it does any work."""
    return built(composed(*words))


def built(settings):
    """All that a task builds before it does any work, from its settings; a few build nothing."""
    if settings.task in ("collect", "transmit", "calibrate", "train_detector"):
        return None
    if settings.task in ("record", "receive"):
        settings = with_panel_of(settings, MessagePlan(PanelShape(), Signalling()))
    plan = build_plan(settings)
    plan.world.simulator()
    if settings.task == "classifiers":
        return build_classifier_study(settings, settings.comparison)
    if settings.task == "figures":
        return plan_figures(settings, settings.figures)
    if settings.task == "effects":
        return build_effect_study(settings, settings.effects)
    if settings.task == "tradeoff":
        return build_tradeoff_study(settings, settings.tradeoff)
    return plan


def complaint_of(*words):
    """The one line by which a command line is refused."""
    try:
        study_of(*words)
    except VoccError as error:
        said = str(error)
    except HYDRA_ERRORS as error:
        said = complaint(error)
    else:
        raise AssertionError(f"{words} are accepted")
    assert "\n" not in said
    return said
