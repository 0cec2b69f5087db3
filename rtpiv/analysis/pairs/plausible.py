"""Plausibility of the given scale and time between frames, by the vectors that they make."""

SOUND_M_S = 343.0  # in air; few flows are faster
VIEW_MM = (0.02, 20_000.0)  # widths of views that a camera has, with much room


def scale_warnings(speed_m_s: float, width_px: int, mm_per_px: float) -> tuple[str, ...]:
    """Ask whether scale and time are right, where speeds or the width of the view are not plausible.

    Parameters
    ----------
    speed_m_s : float
        Median of the vectors; 0 where no time is known.
    width_px : int
        Of the frame.
    mm_per_px : float
        What a pixel shows.
    """
    view_mm = width_px * mm_per_px
    low, high = VIEW_MM
    wrong = []
    if speed_m_s > SOUND_M_S:
        wrong.append(f"the median speed is {speed_m_s:.4g} m/s, faster than sound in air")
    if not low <= view_mm <= high:
        wrong.append(f"the view is {view_mm:.4g} mm wide")
    if not wrong:
        return ()
    shown = f"a pixel of {mm_per_px:.4g} mm, a view of {view_mm:.4g} mm"
    return (f"{' and '.join(wrong)}: are the scale ({shown}) and the time between the frames right?",)
