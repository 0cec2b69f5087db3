"""Nodes of the plane that lie behind a body, as the pinhole sees it past all glass."""

from ground.jit import Array, kernel


@kernel
def mark_behind(first: Array, grid: Array, pinhole: Array, capsule: Array, marks: Array) -> None:
    """Mark the nodes whose straight line to the pinhole comes within a capsule.

    `first` (2,): row and column of the node that the first mark stands for; it may lie beyond the grid.
    `grid` (3,): x0, y0, pitch.  `capsule` (7,): start, end, radius.  Out: `marks` (h, w) bool; marks stay
    marked.

    The closest points of two segments: s along the capsule's axis, t from the node to the pinhole, both 0 to 1;
    the square of the distance is convex, so clamping the one and solving for the other twice settles it.
    """
    cx, cy, cz = pinhole[0], pinhole[1], pinhole[2]
    ax, ay, az = capsule[0], capsule[1], capsule[2]
    ex, ey, ez = capsule[3] - ax, capsule[4] - ay, capsule[5] - az
    ee = ex * ex + ey * ey + ez * ez
    for row in range(marks.shape[0]):
        y = grid[1] - (first[0] + row) * grid[2]
        for column in range(marks.shape[1]):
            x = grid[0] + (first[1] + column) * grid[2]
            dx, dy, dz = cx - x, cy - y, cz
            wx, wy, wz = x - ax, y - ay, -az
            dd = dx * dx + dy * dy + dz * dz
            de = dx * ex + dy * ey + dz * ez
            wd = wx * dx + wy * dy + wz * dz
            we = wx * ex + wy * ey + wz * ez
            across = dd * ee - de * de
            s = 0.0
            if ee > 0.0:
                s = min(max((dd * we - de * wd) / across, 0.0), 1.0) if across > 1e-14 * dd * ee else 0.0
            t = min(max((s * de - wd) / dd, 0.0), 1.0)
            if ee > 0.0:
                s = min(max((we + t * de) / ee, 0.0), 1.0)
                t = min(max((s * de - wd) / dd, 0.0), 1.0)
            gx, gy, gz = wx + t * dx - s * ex, wy + t * dy - s * ey, wz + t * dz - s * ez
            if gx * gx + gy * gy + gz * gz < capsule[6] * capsule[6]:
                marks[row, column] = True
