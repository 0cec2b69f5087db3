"""What contacts and a board behind a packing would tell of its balls, before anything is built."""

from rtpiv.analysis.views.sigma_forecast import packing_forecast
from tests.tracer.scenes import ball, camera_at
from tracer.scene.scene import Scene


def test_contacts_add_what_the_board_does_not_show():
    """A ball hidden behind another touches it: board and contacts know more than either."""
    balls = (
        ball("top", 0.0, 0.0, 50.0, 15.0),
        ball("left", -18.0, 0.0, 26.0, 15.0),
        ball("right", 18.0, 0.0, 26.0, 15.0),
    )
    scene = Scene(camera_at(focal_px=1600.0, sensor_px=(320, 320)), balls)
    contacts, board, both = packing_forecast(scene, 0.02)
    assert [one.known_by for one in (contacts, board, both)] == [
        "contacts", "the board behind", "the board and contacts"
    ]  # fmt: skip
    assert (
        contacts.along_mm[0] > 0.3
    )  # known to a millimetre before, and contacts do not say where the packing stands
    assert both.along_mm[1] < 0.8 * board.along_mm[1] < 0.3
    assert both.sideways_mm[1] <= board.sideways_mm[1] < 0.05
