"""Classifiers beside FLDA: what they see of an LED, how they are trained, and those that are shipped."""

from .adapters import SklearnClassifier, TorchClassifier, scaled
from .inputs import Inputs, Patch
from .protocol import Classifier, Guarded
from .rules import FldaClassifier, LmmseEqualizer, PanelKMeans, PanelOtsu, TagPlanes
from .training import Mlp, PatchCnn

__all__ = [
    "Classifier",
    "FldaClassifier",
    "Guarded",
    "Inputs",
    "LmmseEqualizer",
    "Mlp",
    "PanelKMeans",
]
__all__ += [
    "PanelOtsu",
    "Patch",
    "PatchCnn",
    "SklearnClassifier",
    "TagPlanes",
    "TorchClassifier",
    "scaled",
]
