"""A window that shows frames with the panel's corners and bits while they are read: Rerun's viewer."""

import numpy as np

from vocc_torch.errors import VoccError, library
from vocc_torch.report.annotation import led_centres_px
from vocc_torch.studies.decode.reading import Reading


class Viewer:
    """Rerun's viewer in a process of its own; its timeline goes back to every frame.

    Raises:
        VoccError: the library is not installed, or the viewer does not start.
    """

    def __init__(self) -> None:
        self.rerun = rerun = library("rerun", "viewer", "decode.show is true")
        rerun.init("vocc-torch decode")
        try:
            rerun.spawn()
        except Exception as error:  # of the viewer's process
            raise VoccError(
                f"decode.show is true: the viewer does not start ({error})"
            ) from None

    def show(self, reading: Reading) -> None:
        """Send a frame, and the corners and bits of its panel."""
        rerun = self.rerun
        rerun.set_time("frame", sequence=reading.frame.index)
        rerun.log("frame", rerun.Image(np.ascontiguousarray(reading.frame.colour)))
        if not reading.found:
            rerun.log("frame/panel", rerun.Clear(recursive=True))
            return
        outline = reading.corners_px[[0, 1, 2, 3, 0]]
        rerun.log("frame/panel/outline", rerun.LineStrips2D([outline]))
        on, off = (0, 114, 178), (230, 159, 0)
        colours = [on if bit else off for bit in reading.bits.ravel()]
        points = led_centres_px(reading.corners_px, reading.bits)
        rerun.log(
            "frame/panel/bits",
            rerun.Points2D(points, colors=colours, radii=2.0),  # px
        )
