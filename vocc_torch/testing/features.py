"""The tests that every feature passes."""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from vocc_torch.testing.parts import Answer, PartCase
from vocc_torch.types import PanelShape

Feature = Callable[[Tensor, PanelShape], Tensor]


class FeatureCase(PartCase):
    """Tests of a feature; a subclass named ``Test...`` writes :meth:`feature` and :meth:`patches`.

    Attributes:
        tells_on_from_off: whether an LED that shines has another value than one that does not.
    """

    tells_on_from_off: ClassVar[bool] = True

    @abstractmethod
    def feature(self) -> Feature:
        """Give the feature: a function of (B,1,(R+2)K,(C+2)K) grey values and the panel's shape."""

    def patches(self, shape: PanelShape, samples: int) -> Tensor:
        """Draw three rectified panels with one On LED in three, (3,1,(R+2)K,(C+2)K) float32."""
        generator = torch.Generator().manual_seed(3)
        bits = torch.arange(shape.leds).view(1, *shape.sides) % 3 == 0
        light = torch.nn.functional.pad(60 + 120.0 * bits, (1, 1, 1, 1), value=50.0)
        scale = torch.ones(samples, samples)
        grey = torch.kron(light.expand(3, -1, -1).contiguous(), scale)
        return (grey + torch.rand(grey.shape, generator=generator))[:, None]

    def asked(self) -> tuple[Answer, Tensor]:
        """Give the feature of panels of 6 x 6 LEDs, and three of them."""
        shape, feature = PanelShape(6, 6), self.feature()
        return lambda patches: feature(patches, shape), self.patches(shape, 8)

    @pytest.mark.parametrize("size", [(1, 1), (2, 3), (4, 4), (8, 8), (5, 16)])
    @pytest.mark.parametrize("samples", [2, 5, 8])
    def test_every_led_has_a_finite_value(
        self, size: tuple[int, int], samples: int
    ) -> None:
        """Values are (B,R,C), floating and finite, for any panel and grid."""
        shape = PanelShape(*size)
        values = self.feature()(self.patches(shape, samples), shape)
        assert values.shape == (3, *size)
        assert values.is_floating_point()
        assert values.isfinite().all()

    def test_on_differs_from_off(self) -> None:
        """The values of On and Off LEDs lie apart by more than they spread, if the case says so."""
        answer, patches = self.asked()
        values = answer(patches)[0].flatten().double()
        on = torch.arange(len(values)) % 3 == 0
        apart = (values[on].mean() - values[~on].mean()).abs()
        assert (
            not self.tells_on_from_off or apart > values[on].std() + values[~on].std()
        )

    @pytest.mark.parametrize("level", [0.0, 1e-3, 90.0, 255.0])
    def test_panels_of_one_grey_have_finite_values(self, level: float) -> None:
        """Black, dim and white panels are measured; 0/0 has an answer."""
        shape = PanelShape(3, 4)
        assert self.feature()(torch.full((2, 1, 25, 30), level), shape).isfinite().all()

    def test_double_precision_gives_the_same_values(self) -> None:
        """float64 patches have the values of float32 ones, but for rounding."""
        answer, patches = self.asked()
        torch.testing.assert_close(
            answer(patches.double()).float(),
            answer(patches).float(),
            rtol=1e-3,
            atol=1e-3,
        )
