"""The public test classes on the locators, classifiers and features that ship, and on the examples."""

import sys
from functools import lru_cache
from pathlib import Path

import pytest
import torch

from vocc_torch import Camera, Scene, Simulator
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver import classifiers, features
from vocc_torch.receiver.locators import (
    DetectorLocator,
    OutsideLocator,
    PaperLocator,
    RefinedLocator,
)
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.testing import ClassifierCase, FeatureCase, LocatorCase
from vocc_torch.types import PanelShape

EXAMPLES = Path(__file__).parents[2] / "examples"


@lru_cache
def rendered():
    """Three small frames of the paper's panel, and its corners."""
    simulator = Simulator(
        Camera(width_px=320, height_px=240, sensor_width_mm=2.2), framing="full"
    )
    scene = Scene.of(3, distance_m=40.0)
    bits = torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(5)) < 0.5
    return simulator.render(scene, bits), simulator.true_panels(scene).corners_px


class Panels(LocatorCase):
    def scenes(self):
        return rendered()


class TestPaperLocator(Panels):
    def locator(self):
        return PaperLocator()


class TestRefinedLocator(Panels):
    tolerance_cells = 0.1

    def locator(self):
        return RefinedLocator()


class TestDetectorLocator(Panels):
    def locator(self):
        return DetectorLocator()


class TestDetectorInEightBits(Panels):
    def locator(self):
        return DetectorLocator(arithmetic="int8")


class TestExampleLocator(Panels):
    def locator(self):
        return OutsideLocator(
            PlugIn("locators.box", "box", f"{EXAMPLES}/locators/brightest.py:Brightest")
        )

    def test_it_is_hashed_and_compared_by_its_settings(self):
        pytest.skip("a part from outside is compared by its text")


class Learned(ClassifierCase):
    """Panels of three numbers an LED, of which On and Off differ in all."""

    def panels(self):
        generator = torch.Generator().manual_seed(2)
        bits = torch.rand(24, 4, 4, generator=generator) < 0.5
        return torch.rand(24, 4, 4, 3, generator=generator) + bits[..., None], bits


class TestFldaClassifier(Learned):
    def classifier(self):
        return classifiers.FldaClassifier()


class TestLmmseEqualizer(Learned):
    def classifier(self):
        return classifiers.LmmseEqualizer(classes=1)


class TestExampleClassifier(Learned):
    def classifier(self):
        sys.path.insert(0, str(EXAMPLES / "classifiers"))
        from nearest_mean import NearestMean

        return NearestMean()


class Own(ClassifierCase):
    """Panels of nine grey values an LED, which each rule parts by itself."""

    def panels(self):
        generator = torch.Generator().manual_seed(2)
        bits = torch.rand(24, 4, 4, generator=generator) < 0.5
        return 0.2 + 0.05 * torch.rand(24, 4, 4, 9, generator=generator) + 0.5 * bits[
            ..., None
        ], bits


class TestPanelOtsu(Own):
    def classifier(self):
        return classifiers.PanelOtsu()


class TestPanelKMeans(Own):
    def classifier(self):
        return classifiers.PanelKMeans()


class TestTagPlanes(Own):
    def classifier(self):
        return classifiers.TagPlanes(sharpening=0.0)


class TestAgr(FeatureCase):
    def feature(self):
        return lambda patches, shape: features.level_ratios(
            features.cell_means(patches, shape)
        )[:, 0]


class TestNgr(FeatureCase):
    tells_on_from_off = False

    def feature(self):
        return lambda patches, shape: features.level_ratios(
            features.cell_means(patches, shape)
        )[:, 1]


class TestGri(FeatureCase):
    def feature(self):
        def inwardness(patches, shape):
            size = torch.full((len(patches),), 5.0)
            return features.gradient_radial_inwardness(patches, shape, size, size)

        return inwardness


class TestExampleFeature(FeatureCase):
    tells_on_from_off = False

    def feature(self):
        return PlugIn.of(
            "features.spread", f"{EXAMPLES}/features/cell_deviation.py:cell_deviation"
        ).made


def test_a_case_can_fail():
    class Blind(Panels):
        def locator(self):
            return PaperLocator(min_compactness=1.0)

    with pytest.raises(AssertionError):
        Blind().test_panels_are_found()
    _, corners = rendered()
    assert float(torch.maximum(*cell_size_px(corners, PanelShape())).min()) > 4


def test_a_case_without_a_method_is_refused_by_the_methods_name():
    with pytest.raises(TypeError, match="TestNothing must write classifier and panels"):
        type("TestNothing", (ClassifierCase,), {})
