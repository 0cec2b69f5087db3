"""Light that crosses a bed: rays of a sheet through the bodies, and what they leave on the plane between them.

The world is that of the light (``tracer.strategies.light_map``): it goes down z, y is the height over the sheet
and x runs across.  A ray is cut into its straight pieces in the gas (`trace_pieces`).  Neighbours that meet the
same bodies bound a tube of light; a tube is halved until its middle ray goes where its sides say, and where
neighbours part, at the edge of a shadow, MOST_HALVINGS times.  Each tube carries a power; each piece of length l
leaves power times l on the nodes below it (a track-length estimator), so that their sum over the area is the
integral of the fluence over the height:

    brightness = integral of fluence dz,      height = integral of z fluence dz / brightness.

A piece counts column by column (or row by row, whichever it crosses more of), with what it covers of each, and is
shared linearly between the two nodes beside it: nothing is lost or gained by the raster.
"""

import math
from typing import NamedTuple

from ground.jit import Array, kernel, kernel_composed
from tracer.kernels.ball import entry_of_shape
from tracer.kernels.branches import NOTHING
from tracer.kernels.rays import MAX_EVENTS, OTHER, PASSED, SHAPED, TURNED, Crossing, trace_ray
from tracer.kernels.rooms import OUT, OUTERMOST
from tracer.kernels.sphere import RADIUS, foot, rotate
from tracer.kernels.vectors import Vector, add, dot, move, subtract, vector_at
from tracer.kernels.world import BLOCKED, MISSED_PLANE, RECOVERED, World, meets_other, next_body

# Columns of a piece: where it starts and ends, share of the light in it, at which event it ends, what starts it.
START, END, LIGHT, EVENT, STARTED, PIECE = 0, 3, 6, 7, 8, 9
PIECES = MAX_EVENTS + 2
UNKNOWN, KNOWN, AT_WALL = 0.0, 1.0, 2.0  # start of a piece: where the next ray begins; given; also the end before
LEFT, STOPPED = -1.0, -1000.0  # events: no body is left to meet; less the number of the body that stops the ray
MOST_HALVINGS = 9
FAINTEST = 1e-3  # share of the light below which a ray is given up
LINES_PER_NODE = 3.0  # across a tube: a raster of a third of a node ripples by 4 % at most
MOST_LINES = 400
EMITTED, PASSED_ON, ABSORBED = range(3)  # of the powers


class Raster(NamedTuple):
    """Nodes and the light's way over them.

    Parameters
    ----------
    frame : (6,) float64
        Column = f0 + f1 x + f2 z and row = f3 + f4 x + f5 z of a point.
    reach : float
        Heights that count, either way [mm].
    far : float
        Radius about the middle of the view at which rays end [mm].
    middle : float
        z of the middle of the view.
    tolerance : float
        Of a middle ray from where its neighbours say [mm].
    """

    frame: Array
    reach: float
    far: float
    middle: float
    tolerance: float


@kernel_composed
def keep_pieces(kept: Array, c: Crossing, world: World) -> Array:
    """Record the piece that ends at a crossing, and where the next begins if that is known (PIECES, PIECE)."""
    piece, after = kept[c.place], kept[c.place + 1]
    p, entry = c.w, add(c.w, c.d)
    after[LIGHT], after[STARTED] = piece[LIGHT] * c.light * c.share, KNOWN
    leaving = c.w
    if c.kind == OTHER:
        after[STARTED] = AT_WALL if c.way == OUT else UNKNOWN
        if len(world.others) > 0 and c.way != OUT:
            entry = move(p, meets_other(p, c.d, c.body, world.others), c.d)
    else:
        ball = world.spheres[c.body]
        centre = vector_at(ball, 0)
        p = add(c.w, centre)
        entry = leaving = add(centre, c.a)
        if c.kind == TURNED:
            half = math.sqrt(max(ball[RADIUS] * ball[RADIUS] - c.b2, 0.0))
            a, d = rotate(c.a, c.d, c.b2, c.turn)
            entry, leaving = add(centre, move(c.a, -half, c.d)), add(centre, move(a, half, d))
        elif c.kind == SHAPED:
            entry = entry_of_shape(p, c.d, c.body, world.spheres, world.shapes)
        elif c.kind != PASSED:
            after[LIGHT] = 0.0
    begin_piece(kept, c.place, p)
    piece[END], piece[END + 1], piece[END + 2] = entry
    after[START], after[START + 1], after[START + 2] = leaving
    piece[EVENT] = c.event
    return kept


@kernel
def begin_piece(kept: Array, place: int, p: Vector) -> None:
    """Begin a piece at p where nothing said where it begins; a piece that ended at a wall ends there too."""
    if kept[place, STARTED] != KNOWN:
        kept[place, START], kept[place, START + 1], kept[place, START + 2] = p
        if kept[place, STARTED] == AT_WALL and place > 0:
            kept[place - 1, END], kept[place - 1, END + 1], kept[place - 1, END + 2] = p


@kernel
def trace_pieces(p: Vector, d: Vector, world: World, raster: Raster, pieces: Array) -> int:
    """Cut a ray into its pieces in the gas (PIECES, PIECE); return how many there are."""
    pieces[0, LIGHT], pieces[0, STARTED] = 1.0, KNOWN
    pieces[0, START], pieces[0, START + 1], pieces[0, START + 2] = p
    status, p, d, _, events, _, _ = trace_ray(p, d, world, keep_pieces, pieces)
    for k in range(1, events + 1):
        if pieces[k, LIGHT] < FAINTEST:
            return k
    if status not in (RECOVERED, BLOCKED, MISSED_PLANE):
        return int(events)
    begin_piece(pieces, events, p)
    piece = pieces[events]
    q = vector_at(piece, START)
    piece[EVENT] = LEFT
    # To the circle about the middle of the view: x^2 + (z - middle)^2 = far^2.
    x, z, e2 = q[0], q[2] - raster.middle, d[0] * d[0] + d[2] * d[2]
    along, rest = x * d[0] + z * d[2], x * x + z * z - raster.far * raster.far
    square = along * along - e2 * rest
    t = (math.sqrt(square) - along) / e2 if square > 0.0 and e2 > 1e-12 else raster.far
    if status != RECOVERED:
        body = next_body(q, d, NOTHING, OUTERMOST, world)
        piece[EVENT] = STOPPED - body
        if body > NOTHING:
            ball = world.spheres[body]
            m, a = foot(subtract(q, vector_at(ball, 0)), d)
            t = m - math.sqrt(max(ball[RADIUS] * ball[RADIUS] - dot(a, a), 0.0))
        elif len(world.others) > 0 and body < NOTHING:
            t = meets_other(q, d, body, world.others)
    piece[END], piece[END + 1], piece[END + 2] = move(q, max(t, 0.0) if t < math.inf else raster.far, d)
    return int(events + 1)


@kernel
def count_alike(one: Array, ones: int, other: Array, others: int) -> int:
    """Count the first pieces of two rays that end at the same events."""
    count = 0
    while count < min(ones, others) and one[count, EVENT] == other[count, EVENT]:
        count += 1
    return count


@kernel
def is_straight(left: Array, middle: Array, right: Array, count: int, tolerance: float) -> bool:
    """Return whether `count` pieces of a middle ray begin and end halfway between those of its neighbours."""
    for k in range(count):
        if middle[k, LIGHT] < FAINTEST:
            return True
        for i in range(START, END + 3):
            if abs(0.5 * (left[k, i] + right[k, i]) - middle[k, i]) > tolerance:
                return False
    return True


@kernel
def add_line(a: Vector, b: Vector, power: float, raster: Raster, out: Array) -> None:
    """Add power times length of a line from a to b to nodes out (3, h, w), and its moments by height."""
    height, width, f = out.shape[1], out.shape[2], raster.frame
    u, v = f[0] + f[1] * a[0] + f[2] * a[2], f[3] + f[4] * a[0] + f[5] * a[2]
    step = subtract(b, a)
    du, dv, dh = f[1] * step[0] + f[2] * step[2], f[4] * step[0] + f[5] * step[2], step[1]
    low, high = 0.0, 1.0
    for p, d, least, most in (
        (u, du, -1.0, float(width)), (v, dv, -1.0, float(height)), (a[1], dh, -raster.reach, raster.reach),
    ):  # fmt: skip
        if d == 0.0:
            if not least <= p <= most:
                return
        else:
            one, two = (least - p) / d, (most - p) / d
            low, high = max(low, min(one, two)), min(high, max(one, two))
    if not low < high:
        return
    power *= math.sqrt(dot(step, step))
    wide = abs(du) >= abs(dv)
    p, d, q, e = (u, du, v, dv) if wide else (v, dv, u, du)
    most, beside = (width, height) if wide else (height, width)
    if d == 0.0:  # straight up or down: one place
        p, d = p + 0.5, 0.0
    first, last = p + low * d, p + high * d
    begin = max(math.floor(min(first, last) + 0.5), 0)
    end = min(math.floor(max(first, last) + 0.5), most - 1)
    for i in range(begin, end + 1):
        s, t = low, high
        if d != 0.0:
            one, two = (i - 0.5 - p) / d, (i + 0.5 - p) / d
            s, t = max(low, min(one, two)), min(high, max(one, two))
        if not s < t:
            continue
        middle, share = 0.5 * (s + t), power * (t - s)
        z, place = a[1] + middle * dh, q + middle * e
        j = math.floor(place)
        part = place - j
        for k in range(2):
            at, weight = j + k, share * (part if k == 1 else 1.0 - part)
            if 0 <= at < beside:
                row, column = (at, i) if wide else (i, at)
                out[0, row, column] += weight
                out[1, row, column] += weight * z
                out[2, row, column] += weight * z * z


@kernel
def add_tube(one: Array, other: Array, power: float, raster: Raster, out: Array) -> None:
    """Add the light between two pieces."""
    a, b = vector_at(one, START), vector_at(one, END)
    to_a, to_b = subtract(vector_at(other, START), a), subtract(vector_at(other, END), b)
    wide = math.sqrt(max(dot(to_a, to_a), dot(to_b, to_b)))
    node = 1.0 / math.sqrt(raster.frame[1] * raster.frame[1] + raster.frame[4] * raster.frame[4])
    lines = int(min(max(math.ceil(wide / node * LINES_PER_NODE), 1.0), MOST_LINES))
    for k in range(lines):
        at = (k + 0.5) / lines
        light = one[LIGHT] + at * (other[LIGHT] - one[LIGHT])
        add_line(move(a, at, to_a), move(b, at, to_b), power / lines * light, raster, out)


@kernel
def add_between(
    one: Array, ones: int, other: Array, others: int, power: float, raster: Raster, out: Array, powers: Array
) -> None:
    """Add the light between two rays: a tube while they go together, behind that each with half of the power."""
    together = count_alike(one, ones, other, others)
    for k in range(together):
        add_tube(one[k], other[k], power, raster, out)
    powers[EMITTED] += power
    for ray, count in ((one, ones), (other, others)):
        for k in range(together, count):
            add_tube(ray[k], ray[k], 0.5 * power, raster, out)
        last = ray[count - 1]
        if last[EVENT] == LEFT:
            powers[PASSED_ON] += 0.5 * power * last[LIGHT]
        elif last[EVENT] < LEFT:
            powers[ABSORBED] += 0.5 * power * last[LIGHT]


@kernel
def emit(s: float, layer: Array, source: Array, world: World, raster: Raster, pieces: Array) -> int:
    """Trace the ray of a layer (height, slope, weight) that crosses the view's middle line at s; count its pieces.

    ``source``: distance before the middle where rays begin, 1 / distance of the fan's apex, place of the focus
    behind the middle, 1 / (standard deviation along)^2.
    """
    back, bend, focus = source[0], source[1], source[2]
    along = 1.0 / math.sqrt(1.0 + s * s * bend * bend + layer[1] * layer[1])
    d = (s * bend * along, layer[1] * along, -along)
    p = (s - back * s * bend, layer[0] - layer[1] * (back + focus), raster.middle + back)
    return trace_pieces(p, d, world, raster, pieces)


@kernel
def light_layers(
    layers: Array, places: Array, source: Array, world: World, raster: Raster,
    scratch: Array, out: tuple[Array, Array],
) -> None:  # fmt: skip
    """Add the light of layers (N, 3) between places (M,) across to nodes (3, h, w) and powers (3,).

    `scratch` (MOST_HALVINGS + 3, PIECES, PIECE): one ray on the left, one in the middle, the others on the right.
    """
    nodes, powers = out
    left, middle = scratch[0], scratch[1]
    for index in range(layers.shape[0]):
        layer = layers[index]
        lefts = emit(places[0], layer, source, world, raster, left)
        at = places[0]
        for i in range(1, places.shape[0]):
            top, wide = 2, places[i] - places[i - 1]
            scratch[2, PIECES - 1, START] = emit(places[i], layer, source, world, raster, scratch[2])
            scratch[2, PIECES - 1, END] = places[i]
            while top >= 2:
                right = scratch[top]
                rights, to = int(right[PIECES - 1, START]), right[PIECES - 1, END]
                between = 0.5 * (at + to)
                middles = emit(between, layer, source, world, raster, middle)
                alike = min(count_alike(left, lefts, middle, middles), count_alike(middle, middles, right, rights))
                fine = alike == lefts and alike == middles and alike == rights
                fine = fine and is_straight(left, middle, right, alike, raster.tolerance)
                if not fine and top < MOST_HALVINGS + 2 and to - at > 1.5 * wide * 0.5**MOST_HALVINGS:
                    top += 1
                    for k in range(middles):
                        for column in range(PIECE):
                            scratch[top, k, column] = middle[k, column]
                    scratch[top, PIECES - 1, START], scratch[top, PIECES - 1, END] = middles, between
                    continue
                power = layer[2] * (to - at) * math.exp(-0.5 * between * between * source[3])
                add_between(left, lefts, middle, middles, 0.5 * power, raster, nodes, powers)
                add_between(middle, middles, right, rights, 0.5 * power, raster, nodes, powers)
                for k in range(rights):
                    for column in range(PIECE):
                        left[k, column] = right[k, column]
                lefts, at, top = rights, to, top - 1
