"""The tests that every locator passes."""

import pickle
from abc import abstractmethod
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.testing.parts import Answer, PartCase
from vocc_torch.types import Frames, Panels, PanelShape


def equal(first: Panels, second: Panels) -> bool:
    """Whether two sets of panels are the same to the last bit."""
    return all(
        torch.equal(getattr(first, name), getattr(second, name))
        for name in Panels.__slots__
    )


class LocatorCase(PartCase):
    """Tests of a locator; a subclass named ``Test...`` writes :meth:`locator` and :meth:`scenes`.

    Attributes:
        shape: of the panels in the scenes.
        tolerance_cells: how far a corner may lie from the truth, in LED cells.
        finds_nothing_in_noise: whether noise without a panel holds none for it.

    Example:
        >>> class TestMine(LocatorCase):
        ...     def locator(self):
        ...         return PaperLocator()
        ...
        ...     def scenes(self):
        ...         return frames, corners_px  # what it must find
    """

    shape: ClassVar[PanelShape] = PanelShape()
    tolerance_cells: ClassVar[float] = 0.5
    finds_nothing_in_noise: ClassVar[bool] = False

    @abstractmethod
    def locator(self) -> PanelLocator:
        """Build the locator."""

    @abstractmethod
    def scenes(self) -> tuple[Frames, Tensor]:
        """Give at least three whole uint8 frames with a panel each, and the corners (B,4,2), px."""

    def asked(self) -> tuple[Answer, Tensor]:
        """Give corners, found, score and candidates of grey frames (B,1,H,W) as one row each, and frames."""
        locator = self.locator()

        def answer(grey: Tensor) -> Tensor:
            panels = locator(Frames.whole(grey), self.shape)
            one_a_frame = (panels.found, panels.score, panels.candidates)
            columns = [column.double()[:, None] for column in one_a_frame]
            return torch.cat([panels.corners_px.flatten(1), *columns], dim=1)

        return answer, self.scenes()[0].grey

    def located(self) -> tuple[Frames, Panels]:
        """Locate the panels of the scenes."""
        frames, _ = self.scenes()
        return frames, self.locator()(frames, self.shape)

    def assert_near(self, corners_px: Tensor, expected_px: Tensor) -> None:
        """Demand corners (B,4,2) within the tolerance."""
        cell_px = torch.maximum(*cell_size_px(expected_px, self.shape))
        cells = (corners_px - expected_px).norm(dim=2).amax(1) / cell_px
        assert (cells <= self.tolerance_cells).all(), cells.tolist()

    def test_panels_are_found(self) -> None:
        """Every panel is found, and its corners lie within the tolerance."""
        panels = self.located()[1]
        assert panels.found.all()
        self.assert_near(panels.corners_px, self.scenes()[1])

    def test_answers_have_the_right_kind(self) -> None:
        """Shapes and dtypes are those of ``Panels``, and corners are plain tensors."""
        frames, panels = self.located()
        kinds = {
            "corners_px": ((len(frames), 4, 2), torch.float64),
            "found": ((len(frames),), torch.bool),
            "score": ((len(frames),), torch.float64),
            "candidates": ((len(frames),), torch.int64),
        }
        for name, kind in kinds.items():
            column = getattr(panels, name)
            assert (column.shape, column.dtype) == kind, name
            assert not column.requires_grad

    def test_a_picture_that_is_moved_moves_the_corners(self) -> None:
        """With border pixels added on the left and above, corners move by as much."""
        frames, panels = self.located()
        wide = torch.nn.functional.pad(
            frames.grey.float(), (16, 0, 8, 0), mode="replicate"
        )
        moved = self.locator()(Frames.whole(wide.to(torch.uint8)), self.shape)
        expected_px = panels.corners_px + torch.tensor([16.0, 8.0])
        self.assert_near(moved.corners_px, expected_px)

    def test_arrays_are_taken(self) -> None:
        """A NumPy array is as good as a tensor."""
        frames, panels = self.located()
        assert equal(self.locator()(frames.grey[:, 0].numpy(), self.shape), panels)

    def test_the_default_dtype_changes_nothing(self) -> None:
        """Torch's default dtype is not looked at."""
        frames, panels = self.located()
        before = torch.get_default_dtype()
        torch.set_default_dtype(torch.float64)
        try:
            assert equal(self.locator()(frames, self.shape), panels)
        finally:
            torch.set_default_dtype(before)

    @pytest.mark.parametrize("level", [0, 90, 255])
    def test_nothing_is_found_in_a_constant_frame(self, level: int) -> None:
        """One grey value shows no panel: corners and score are zeros."""
        panels = self.locator()(
            torch.full((2, 96, 128), level, dtype=torch.uint8), self.shape
        )
        assert not panels.found.any()
        assert not panels.corners_px.any()
        assert not panels.score.any()

    @pytest.mark.parametrize("size", [(1, 1), (3, 40), (12, 12), (90, 120)])
    def test_noise_gives_finite_answers(self, size: tuple[int, int]) -> None:
        """Noise of any size breaks nothing, and shows no panel where the case says so."""
        draws = torch.Generator().manual_seed(1)
        noise = torch.randint(0, 256, (2, *size), generator=draws).byte()
        panels = self.locator()(noise, self.shape)
        assert panels.corners_px.isfinite().all()
        assert panels.score.isfinite().all()
        assert not (self.finds_nothing_in_noise and panels.found.any())

    def test_the_best_candidate_is_the_panel(self) -> None:
        """The first candidate of each frame has the panel's corners and score."""
        frames, panels = self.located()
        candidates = self.locator().locate(frames, self.shape)
        assert torch.equal(candidates.frame, candidates.frame.sort().values)
        for row in range(len(frames)):
            best = candidates[candidates.frame == row][:1]
            assert torch.equal(best.corners_px[0], panels.corners_px[row])
            assert torch.equal(best.score[0], panels.score[row])

    def test_it_is_hashed_and_compared_by_its_settings(self) -> None:
        """Receivers that share a locator locate once."""
        assert self.locator() == self.locator()
        assert hash(self.locator()) == hash(self.locator())

    def test_it_can_be_sent_to_another_process(self) -> None:
        """Pickled and read back it is the same, and its name in results is a word."""
        locator = pickle.loads(pickle.dumps(self.locator()))
        assert locator == self.locator()
        assert locator.name.isidentifier()
