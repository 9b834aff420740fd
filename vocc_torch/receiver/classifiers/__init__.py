"""Classifiers other than FLDA: their inputs, their training, and the classifiers that ship."""

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
    "PanelOtsu",
    "Patch",
    "PatchCnn",
    "SklearnClassifier",
    "TagPlanes",
    "TorchClassifier",
    "scaled",
]
