"""One observation for every receiver: what is simulated, and that nothing is simulated for nobody."""

from dataclasses import replace

import torch
from one_point import sweep_point

from vocc_torch.measure.link import Link
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, Simulator

KEY = BlockKey(0, "link", 0)


def observed(link, frames, *, preambles=False, keys=(KEY,)):
    """All batches of a link."""
    return list(
        link.observe(SceneModel(), list(keys), preambles=preambles, frames=frames)
    )


def test_the_truth_is_used_without_a_locator_and_only_then():
    link = Link(Simulator(), None, Reader())
    (seen,) = observed(link, 8)
    assert torch.equal(
        seen.panels.corners_px, link.simulator.true_panels(seen.scene).corners_px
    )
    (located,) = observed(Link(Simulator(), PaperLocator(), Reader()), 8)
    assert not torch.equal(located.panels.corners_px, seen.panels.corners_px)
    assert float((located.panels.corners_px - seen.panels.corners_px).abs().max()) < 12


def test_preambles_are_the_same_scenes_all_on_and_all_off():
    (seen,) = observed(Link(Simulator(), None, Reader()), 16, preambles=True)
    levels, greys = seen.preambles, seen.readings.greys
    assert bool((levels.on.average > levels.off.average).all())
    # What a frame's LED shows lies between the two, but for the light of its neighbours.
    assert bool((greys.average <= levels.on.average + 1e-3).all())
    assert bool((greys.average >= levels.off.average - 1e-3).all())


def test_each_preamble_can_be_located_by_itself():
    paper, reader, searched = PaperLocator(), Reader(), []

    def no_off_preamble(frames, shape):
        searched.append(frames)
        panels = paper(frames, shape)
        lost = torch.full_like(panels.found, len(searched) == 3)
        return replace(panels, found=panels.found & ~lost)

    link = Link(Simulator(), no_off_preamble, reader, locates_preambles=True)
    (seen,) = observed(link, 16, preambles=True)
    (together,) = observed(Link(Simulator(), paper, reader), 16, preambles=True)
    on, off = seen.preambles
    where = paper(seen.takes[1], reader.shape)
    assert torch.equal(on.average, reader.read(seen.takes[1], where).greys.average)
    assert not torch.equal(on.average, together.preambles.on.average)
    assert torch.equal(off.average, together.preambles.off.average)
    assert torch.equal(seen.readings.features, together.readings.features)


def count_renders(monkeypatch):
    """Count the frames that are rendered, by whether all their bits are equal."""
    frames = {"data": 0, "preamble": 0}
    render = Simulator.render

    def counted(self, scene, bits, **options):
        uniform = bits.flatten(1).all(1) | (~bits).flatten(1).all(1)
        frames["preamble"] += int(uniform.sum())
        frames["data"] += int((~uniform).sum())
        return render(self, scene, bits, **options)

    monkeypatch.setattr(Simulator, "render", counted)
    return frames


def test_preambles_are_rendered_for_greyscale_receivers_only(
    make_plan, trained, monkeypatch
):
    frames = count_renders(monkeypatch)
    fisher = make_plan(names=("flda_agr", "flda_gri", "flda_2", "flda_3"), frames=64)
    sweep_point(fisher, trained, 66.0)
    assert frames == {"data": 64, "preamble": 0}
    for greyscale in ("center_greyscale", "average_greyscale"):
        frames.update(data=0, preamble=0)
        both = make_plan(names=("flda_3", greyscale), frames=70)
        sweep_point(both, trained, 66.0)
        assert frames == {"data": 70, "preamble": 140}
