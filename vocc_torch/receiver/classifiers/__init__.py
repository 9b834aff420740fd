"""Classifiers other than FLDA: their inputs, their training, and the classifiers that ship."""

from .estimators import SklearnClassifier, scaled
from .inputs import Inputs, Patch
from .networks import Mlp, PatchCnn
from .protocol import Classifier, Guarded
from .rules import FldaClassifier, LmmseEqualizer, PanelKMeans, PanelOtsu, TagPlanes
from .training import TorchClassifier

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
