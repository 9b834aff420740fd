"""Test classes for parts that plug in: a subclass writes two methods and inherits the tests. Needs pytest."""

from .classifiers import ClassifierCase
from .features import FeatureCase
from .locators import LocatorCase

__all__ = ["ClassifierCase", "FeatureCase", "LocatorCase"]
