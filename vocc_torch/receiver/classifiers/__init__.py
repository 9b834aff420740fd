"""Classifiers beside FLDA: what they see of an LED, how they are trained, and those that are shipped."""

from vocc_torch.receiver.classifiers.inputs import Inputs as Inputs
from vocc_torch.receiver.classifiers.inputs import Patch as Patch
from vocc_torch.receiver.classifiers.protocol import Classifier as Classifier
from vocc_torch.receiver.classifiers.protocol import Guarded as Guarded
from vocc_torch.receiver.classifiers.rules import FldaClassifier as FldaClassifier
from vocc_torch.receiver.classifiers.rules import LmmseEqualizer as LmmseEqualizer
from vocc_torch.receiver.classifiers.rules import PanelKMeans as PanelKMeans
from vocc_torch.receiver.classifiers.rules import PanelOtsu as PanelOtsu
from vocc_torch.receiver.classifiers.rules import TagPlanes as TagPlanes
from vocc_torch.receiver.classifiers.sklearn_adapter import SklearnClassifier as SklearnClassifier
from vocc_torch.receiver.classifiers.sklearn_adapter import scaled as scaled
from vocc_torch.receiver.classifiers.torch_classifier import Mlp as Mlp
from vocc_torch.receiver.classifiers.torch_classifier import PatchCnn as PatchCnn
from vocc_torch.receiver.classifiers.torch_classifier import TorchClassifier as TorchClassifier
