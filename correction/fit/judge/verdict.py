"""The verdict on a fitted model, in numbers and in words.

The test of every way (`model_test`) says whether and where the model is wrong, the hypotheses say what it most
likely is, and the correlation of neighbours (`correlation`) says what the covariance must count.  What the test
finds is an error of the map of its own, `systematic_px`, on every way whose residuals bend more than noise would,
even where that is too little for an alarm: corners or model may be to blame, and the map is not taken for better.
Behind glass it may be worse than residuals show, for balls follow what is wrong with the camera: so the hypotheses
are asked as soon as residuals bend more than noise would, and their changes of the scene are counted.

A cause that is named explains its field of residuals.  What the map is off by is then the difference that the
cause makes, and what a fit that knew the cause would leave open: its corners err, and err alike, by what the cause
leaves (`ResidualsGivenCause`).  Counted by all residuals, the field would be in sigma three times, as noise, as
what neighbours have in common and as the difference: ten times too much behind glass for a board that is bent.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.judge.candidates import Evidence
from correction.fit.judge.hypotheses import ErrorHypothesis, likely_cause, rank_hypotheses
from correction.fit.judge.model_test import MODEL_FALSE_ALARMS, Remainder, WayTest, smooth_part, ways_tested
from correction.fit.judge.prior_pulls import PriorPull
from correction.fit.seen.hidden_patches import Hidden, find_hidden_patches
from correction.fit.seen.measurement import MeasuredFrame, by_region, region_factors
from correction.fit.seen.pixel_lock import NAMES as LOCK
from correction.fit.seen.rims_seen import RimSeen
from correction.fit.seen.smear_test import ColourSmear, SmearedView, colour_smear, smear_in_view
from correction.fit.seen.unconfirmed_ways import Misfit, Unconfirmed
from correction.fit.seen.unlisted_parts import Unlisted
from correction.fit.seen.unsure_rims import UnsureRim, in_words
from correction.fit.solve.correlation import Correlation, Lattice, correlation_of
from correction.fit.solve.solver import Corners, Residuals, land_corners
from correction.fit.solve.unknowns import Unknowns
from correction.grid import grid_of
from tracer.masked import MaskedPart

PRIOR_LIMIT = 5.0  # sigmas that a number may be off by what was known of it
STRAINED = 4.0  # and those from which that is an alarm: one of twenty numbers by chance in a thousand labs
COUNTED = 0.05  # chance of noise below which what bends is counted as an error of the map
DIRECT = "the view beside the glass"


@dataclass(frozen=True)
class Verdict:
    """Verdict of the residual test on the model.

    Parameters
    ----------
    ways : tuple of WayTest
        The test of every way that shows enough corners.
    correlation : dict
        Behind glass or not -> how neighbours err alike.
    suspects : tuple of ErrorHypothesis
        What would explain what bends more than noise would, alarm or not, the most likely first.
    smooth_px : (N, 2) float64
        Smooth part of the residual of every corner, raw px.
    hidden : tuple of Hidden
        Patches of corners that should be seen and are not.
    unlisted : tuple of Unlisted
        Parts of frames that are not what the scene shows.
    unconfirmed : tuple of Unconfirmed
        Ways through the glass, and balls, on which too few corners are where the scene shows them.
    rims : tuple of UnsureRim
        Bands around balls whose place is not known to a fraction of a pixel.
    smear : ColourSmear or None
        Colours that smear corners beyond the specified ones; None where too few corners show it.
    wrong_light : str
        Sentence on the light of the target frames, where it cannot be the specified one.
    strained : str
        The free number that is farthest from where it was given, if that is an alarm.
    misfits : tuple of Misfit
        Ways through the glass that frames show bent otherwise than the scene bends them.
    rims_off : tuple of (RimSeen, tuple of MaskedPart)
        Balls whose rim is not where the scene shows it, and what no map is to use for that.
    unexplained : tuple of WayTest or None
        The test of every way once the cause of an alarm is known; None where there is no such cause.
    pulls : tuple of PriorPull
        Priors that fail their joint test.
    """

    ways: tuple[WayTest, ...]
    correlation: dict[bool, Correlation]
    suspects: tuple[ErrorHypothesis, ...]
    smooth_px: NDArray[np.float64]
    hidden: tuple[Hidden, ...] = ()
    unlisted: tuple[Unlisted, ...] = ()
    unconfirmed: tuple[Unconfirmed, ...] = ()
    rims: tuple[UnsureRim, ...] = ()
    smear: ColourSmear | None = None
    wrong_light: str = ""
    strained: str = ""
    misfits: tuple[Misfit, ...] = ()
    rims_off: tuple[tuple[RimSeen, tuple[MaskedPart, ...]], ...] = ()
    unexplained: tuple[WayTest, ...] | None = None
    pulls: tuple[PriorPull, ...] = ()

    @property
    def alarms(self) -> tuple[WayTest, ...]:
        """Ways on which the model is wrong, the worst first."""
        return tuple(sorted((way for way in self.ways if way.alarm), key=lambda way: -way.excess))

    @property
    def corner_noise_px(self) -> float:
        """Corner noise beside the glass, raw px per axis: the rough part of the residuals."""
        return next((way.rough_px for way in self.ways if not way.way), 0.0)

    @property
    def cause(self) -> ErrorHypothesis | None:
        """The most likely error, if anything on the list explains the residuals."""
        return likely_cause(self.suspects)

    @property
    def changes(self) -> tuple[NDArray[np.float64], ...]:
        """Errors (F, .) of the fitted full vector: by the cause, or else by all that may be, as far as likely."""
        return tuple(np.sqrt(share) * one.change for share, one in self._likely if one.change is not None)

    @property
    def shapes(self) -> tuple[tuple[str, NDArray[np.float64]], ...]:
        """Ball and error (5, .) of its shape with each of `changes`; (0, 0) where that is no shape."""
        return tuple(
            (one.ball, np.sqrt(share) * one.shape) for share, one in self._likely if one.change is not None
        )

    @property
    def _likely(self) -> list[tuple[float, ErrorHypothesis]]:
        """Possible errors, each with its share."""
        return [(1.0, self.cause)] if self.cause is not None else [(one.share, one) for one in self.suspects]

    @property
    def systematic_px(self) -> dict[str, float]:
        """Way -> standard deviation of the map's own error on it, raw px per axis; of all ways tested.

        What the cause explains is counted as its change of the scene (`SceneFit.root`), but for what derivatives
        of the map do not say of it.
        """
        ways, left = self.unexplained, 1.0
        if ways is None:
            ways = self.ways
            known = self.cause.share if self.cause is not None and self.cause.change is not None else 0.0
            left = float(np.sqrt(1.0 - known))
        bent = unlike_noise(ways)
        unsaid = [
            float(np.sqrt(sum(share * one.unsaid_px[behind] ** 2 for share, one in self._likely)))
            for behind in (False, True)
        ]
        return {
            way.way: float(np.hypot(left * way.smooth_px * (way in bent), unsaid[way.way != ""])) for way in ways
        }

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words."""
        off = (rim for rim, _ in self.rims_off)
        bodies = map(str, (*off, *self.misfits, *self.unlisted, *self.hidden))
        light = ([str(self.smear)] if self.many_colours else []) + ([self.wrong_light] if self.wrong_light else [])
        found = (*map(str, self.pulls), *bodies, *light)
        balls, ways = ([str(one) for one in self.unconfirmed if one.is_ball is ball] for ball in (True, False))
        ways += [in_words(self.rims)] if self.rims else []
        if self.alarms or (self.strained and not self.pulls):
            return (*self._of_residuals(), *found, *balls, *ways)
        return (*found, *balls, *self._of_residuals(), *ways)

    @property
    def is_right(self) -> bool:
        """True if no test speaks against the model."""
        balls = any(one.is_ball for one in self.unconfirmed)
        bodies = any(not one.rim_of for one in self.unlisted)
        glass = balls or self.misfits or self.rims_off or self.strained
        seen = self.alarms or self.hidden or bodies or glass or self.pulls
        return not (seen or self.many_colours or self.wrong_light)

    @property
    def masked(self) -> tuple[MaskedPart, ...]:
        """Parts that no map is to use."""
        unlisted = [part for one in self.unlisted for part in one.masked]
        unconfirmed = [part for one in self.unconfirmed for part in one.masked]
        hidden, rims = [one.masked for one in self.hidden], [one.masked for one in self.rims]
        misfits = [one.masked for one in self.misfits]
        off = [part for _, parts in self.rims_off for part in parts]
        return (*unlisted, *unconfirmed, *misfits, *off, *hidden, *rims)

    @property
    def many_colours(self) -> bool:
        """True if the light of the target frames has more colours than fit.light gives."""
        return self.smear is not None and self.smear.alarm

    def _of_residuals(self) -> tuple[str, ...]:
        """Sentences on the residuals."""
        if self.strained and not self.alarms:
            cause = f"{self.cause.sentence}. With that as given, " if self.cause is not None else ""
            return (f"{cause}{self.strained}; the map's sigma holds it",)
        if not self.alarms:
            worst = max((way.smooth_px for way in self.ways), default=0.0)
            where = "outside what is masked, " if self.masked else "apart from that, "
            said = (
                f"{'the model is right within the accuracy of the corners: ' if self.is_right else where}residuals"
                f" bend smoothly by no more than {max(worst, 0.001):.3f} px (chance of a false alarm"
                f" {100 * MODEL_FALSE_ALARMS:.0f} %)"
            )
            if self.cause is None:
                return (said,)
            or_else = self.cause.sentence
            return said, f"that is too little for an alarm: corners err so, or {or_else}; the map's sigma holds it"
        worst_way = self.alarms[0]
        best = self.cause
        where = _where(worst_way.way)
        worth = (
            f"residuals through {where} bend smoothly by {worst_way.smooth_px:.2g} px rms,"
            f" {worst_way.largest_px:.2g} at most; its map is worth {worst_way.map_px:.2g} px"
        )
        if best is None:
            cause = (
                f"what is seen through {where} is not what the scene shows, and no cause on the list explains it"
            )
            cure = "check that the scene lists every body, that balls and board are clean and whole, and focus"
            found = [f"{cause}: {worth}; {cure}"]
        else:
            found = [f"{best.sentence}: {worth}"]
            rivals = [one for one in self.suspects[1:3] if one.gain > 0.9 * best.gain]
            found += [f"or nearly as likely: {one.sentence}" for one in rivals]
        for way in self.alarms[1:]:
            found.append(
                f"also through {_where(way.way)}: {way.smooth_px:.2g} px; its map is worth {way.map_px:.2g}"
            )
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "right": self.is_right,
            "false_alarms": MODEL_FALSE_ALARMS,
            "sentences": list(self.sentences),
            "ways": [asdict(way) for way in self.ways],
            "hidden": [asdict(patch) for patch in self.hidden],
            "unlisted": [asdict(part) for part in self.unlisted],
            "unconfirmed": [asdict(one) for one in self.unconfirmed],
            "rims": [asdict(one) for one in self.rims],
            "pulls": [asdict(pull) for pull in self.pulls],
            "misfits": [asdict(one) for one in self.misfits],
            "rims_off": [asdict(rim) for rim, _ in self.rims_off],
            "smear": asdict(self.smear) if self.smear else None,
            "suspects": [one.to_dict() for one in self.suspects],
            "independent_corners": {
                ("behind glass" if behind else "seen directly"): {
                    "corners": one.corners,
                    "independent": round(one.independent, 1),
                    "correlation_of_neighbours": one.neighbours,
                }
                for behind, one in self.correlation.items()
            },
        }


def unlike_noise(ways: Sequence[WayTest]) -> list[WayTest]:
    """Ways whose residuals bend more than those of corners without any smooth error of their own would."""
    return [way for way in ways if way.chance_of_noise < COUNTED / len(ways)]


@dataclass(frozen=True)
class ResidualsGivenCause:
    """Residuals of all corners as the covariance takes them: given the cause, if one is named.

    Parameters
    ----------
    values : sequence of (N, 2) float64
        Residuals frame by frame, in the sigmas of the fit.
    factors : dict
        Behind glass or not -> what these sigmas are to be multiplied with.
    lattices : sequence of Lattice
        The same in multiplied sigmas, with derivatives.
    correlation : dict
        Behind glass or not -> how neighbours err alike.
    """

    values: Sequence[NDArray[np.float64]]
    factors: dict[bool, float]
    lattices: Sequence[Lattice]
    correlation: dict[bool, Correlation]


def judge_model(
    unknowns: Unknowns,
    wide: Unknowns,
    x: NDArray[np.float64],
    frames: Sequence[MeasuredFrame],
    weighted: Sequence[Corners],
    parts: Sequence[Residuals],
) -> tuple[Verdict, ResidualsGivenCause]:
    """Test the model.

    Parameters
    ----------
    unknowns : Unknowns
        What was free, P numbers.
    wide : Unknowns
        With H further ones that are held, as consider parameters.
    x : (P + H,) float64
        The fitted free vector, and zeros.
    frames, weighted, parts :
        All measured corners, frame by frame, with the sigmas that the fit used and the residuals that it left.

    Returns
    -------
    verdict : Verdict
    left : ResidualsGivenCause
    """
    full, free = wide.full(x), len(unknowns.names)
    pitch_mm = grid_of(unknowns.camera(full)).pitch_mm
    rests, rates, sighted = [], [], []
    views: list[SmearedView] = []
    for frame, corners, part in zip(frames, weighted, parts, strict=True):
        sigma = 1.0 / np.diagonal(np.asarray(corners.whiten), axis1=1, axis2=2)
        rays = land_corners(unknowns, full, corners)
        shown = np.nan_to_num(rays.pixel_rate) / pitch_mm
        off = part.value * sigma
        rests.append(Remainder(frame.branch_name, corners.pixel, off, sigma, shown, frame.known_smooth_px))
        rates.append(np.nan_to_num(part.rate))
        sighted.append(replace(frame, corners=corners))
        if frame.corners.glass and len(frame.spread.variance_px2):
            camera = unknowns.camera(full)
            views.append(
                smear_in_view(unknowns.scene, camera, frame.branch_name, frame.axes_px, frame.spread, rays)
            )
    smooth_parts = [smooth_part(rest) for rest in rests]
    ways = tuple(ways_tested(rests, smooth_parts))
    left = _residuals_given(frames, rests, rates, [part.value for part in parts], {False: 1.0, True: 1.0})
    found: list[ErrorHypothesis] = []
    own = [name not in LOCK for name in unknowns.names]
    pull = np.abs(x[:free]) * own  # a number that is free may have moved to hide an error of another
    pulled = float(pull.max(initial=0.0)) > STRAINED
    strained = f"{unknowns.names[int(np.argmax(pull))]} moved {pull.max():.1f} of its sigmas" if pulled else ""
    if pulled or any(way.alarm for way in ways) or unlike_noise(ways):
        values = [one.value for one in left.lattices]
        seen = Evidence(sighted, values, [rate[:, :, :free] for rate in rates], x[:free])
        found = rank_hypotheses(unknowns, full, seen, sum(way.excess for way in ways) + float(x @ x) * pulled)
    smooth = np.concatenate([smooth for smooth, _ in smooth_parts])
    verdict = Verdict(
        ways,
        left.correlation,
        tuple(found),
        smooth,
        find_hidden_patches(frames),
        smear=colour_smear(views),
        strained=strained,
    )
    if not verdict.alarms or verdict.cause is None or verdict.cause.change is None:
        return verdict, left
    # Once the cause is known, corners err by what it leaves: sigmas, correlation and test are taken anew from
    # that.
    factors = region_factors([frame.behind for frame in frames], verdict.cause.left)
    rests = [
        replace(
            rest,
            residual_px=value * rest.sigma_px,
            sigma_px=rest.sigma_px * by_region(frame.behind, factors)[:, None],
        )
        for frame, rest, value in zip(frames, rests, verdict.cause.left, strict=True)
    ]
    left = _residuals_given(frames, rests, rates, verdict.cause.left, factors)
    return replace(verdict, unexplained=tuple(ways_tested(rests))), left


def _residuals_given(
    frames: Sequence[MeasuredFrame],
    rests: Sequence[Remainder],
    rates: Sequence[NDArray[np.float64]],
    values: Sequence[NDArray[np.float64]],
    factors: dict[bool, float],
) -> ResidualsGivenCause:
    """Assemble residuals from remainders in multiplied sigmas and derivatives in those of the fit."""
    lattices = [
        Lattice(
            frame.index,
            frame.branch_name,
            rest.robust_residuals,
            rate / by_region(frame.behind, factors)[:, None, None],
        )
        for frame, rest, rate in zip(frames, rests, rates, strict=True)
    ]
    correlation = {behind: correlation_of(lattices, behind) for behind in (False, True)}
    return ResidualsGivenCause(values, factors, lattices, correlation)


def _where(way: str) -> str:
    return f"`{way}`" if way else DIRECT
