"""Model of the neighbourhood of a chessboard corner: two blurred edges that cross.

Around the corner p, with d = x - p + s1 s2 g and for each edge k = 1, 2 its direction t_k, its normal n_k:

    I(x) = (A + B (f(z1) f(z2) + T)) (1 + g . (x - x0)),       f(z) = erf(z) + h z (3 - 2 z^2) exp(-z^2)
    z_k  = (n_k . d + c_k ((t_k . d)^2 + s_k^2)) / (sqrt(2) s_k)
    T    = 4 sum_m rho^m / m! phi^(m-1)(sqrt(2) z1) phi^(m-1)(sqrt(2) z2)
    rho  = n_1 . n_2 + (t_1 x t_2) (c_1 t_1 + c_2 t_2) . d

Thirteen numbers are free: p, both angles, both curvatures c_k (glass bends edges; a straight line through an
arc would miss the corner by c l^2 / 3 for arms of length l), both blurs (pixel integration only adds 1/12
px^2 to s^2, in any direction), A, B, the slope g of the illumination, which would otherwise pull on p, and
the shape h of the edge, which lenses give tails that erf has not.  n_1 and n_2 are turned so that the product
of the two edges is positive in the quadrant between +axis 1 and +axis 2, whichever handedness the view has;
the sign of B is the shade of the square there.

What lies in the scene comes before the blur, which draws a bent edge towards its hollow side by c s^2 and, in
light that changes, everything against g by s^2 g (each 0.07 px at s = 2 px near a rim), and makes more of a
corner than a product where edges do not cross at right angles: sgn sgn blurred is the bivariate normal
integral, T as Mehler's series, phi the normal density (without it sigmas were up to ten times too large).  Of the
turn of a bent edge, 2 c t, half counts in rho: its skewness takes back the other half.

The pixels asked are those of a cross: arms of half length `reach` and half width `arm` squares in the affine
frame of the view.  The window is an exact set of pixels.
"""

from math import cos, sin

import numpy as np

from ground.jit import Array, kernel

FREE = 13  # px, py, angle 1, angle 2, curvature 1, 2, blur 1, 2, A, B, slope u, slope v, edge shape
SIDE = 121  # largest bounding box of a window [px]
PLAIN = 3.2  # erf is +-1 to 6e-6 from here
INV_SQRT_2 = 0.7071067811865476
TWO_OVER_SQRT_PI = 1.1283791670955126
TWO_OVER_PI = 0.6366197723675814
SQRT_2 = 1.4142135623730951
LEANS = 5  # terms of the series: 1e-3 of the contrast for edges that cross at 50 degrees

# Verdicts; correction.target.corners.CornerReason gives them names.
OK, EDGE, MASKED, SMALL, LOST, MOVED = 0, 1, 2, 3, 4, 5


@kernel
def gather(
    image: Array, mask: Array, centre_u: float, centre_v: float, inverse: Array, extent: Array,
    reach: float, arm: float, box: Array, pixels: Array,
) -> int:  # fmt: skip
    """List the pixels of the cross around a centre; return their number, -EDGE or -MASKED.

    inverse (2, 2) float64 px -> squares; extent (2,) half size of the window for reach = 1 [px];
    mask (H, W) uint8, 0 = not to be used, or (1, 1) = all usable; box (4,) int64 out: u0, v0, width, height;
    pixels (4, SIDE^2 or more) float64 out: u - centre, v - centre, intensity, place in the box.
    """
    height, width = image.shape
    u0 = int(np.ceil(centre_u - reach * extent[0]))
    u1 = int(np.floor(centre_u + reach * extent[0]))
    v0 = int(np.ceil(centre_v - reach * extent[1]))
    v1 = int(np.floor(centre_v + reach * extent[1]))
    if u0 < 0 or v0 < 0 or u1 >= width or v1 >= height:
        return -EDGE
    box[0], box[1], box[2], box[3] = u0, v0, u1 - u0 + 1, v1 - v0 + 1
    masked = mask.size > 1
    count = 0
    for v in range(v0, v1 + 1):
        dv = v - centre_v
        for u in range(u0, u1 + 1):
            du = u - centre_u
            a = abs(inverse[0, 0] * du + inverse[0, 1] * dv)
            b = abs(inverse[1, 0] * du + inverse[1, 1] * dv)
            if a > reach or b > reach or (a > arm and b > arm):
                continue
            if masked and mask[v, u] == 0:
                return -MASKED
            pixels[0, count] = du
            pixels[1, count] = dv
            pixels[2, count] = image[v, u]
            pixels[3, count] = (v - v0) * (u1 - u0 + 1) + (u - u0)
            count += 1
    return count


@kernel
def set_turn(p: Array, turn: Array) -> None:
    """Cosine and sine of both angles of p (FREE,) into turn (4,)."""
    turn[0], turn[1], turn[2], turn[3] = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])
