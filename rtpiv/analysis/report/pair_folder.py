"""The folder of an evaluated pair: vectors and figures as JSON, then a page, which alone needs matplotlib."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from daq.atomic_write import write_json
from ground.printable import utf8
from piv.files.vector_file import write_list, write_vectors, write_vtk
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pairs.pair_vectors import columns_of
from rtpiv.analysis.report.sigma_verdict import sigma_verdict
from rtpiv.analysis.report.tables import claim_table, sigma_table, track_summary

MOST_BODIES = 6  # named


def frame_names(frames: Sequence[Path]) -> dict[str, str]:
    """Return what the frames of a pair are called, and the folder that they are from."""
    names = ", ".join(frame.name for frame in frames)
    return {"frames": utf8(names).decode(), "frames_from": utf8(str(frames[0].parent.resolve())).decode()}


def write_pair(evaluation: Evaluation, vtk: bool = False) -> None:
    """Write all files of the folder of a pair but its page."""
    task, field = evaluation.task, evaluation.field
    out, about = task.out, evaluation.about
    out.mkdir(parents=True, exist_ok=True)
    vectors, timed = evaluation.vectors, {**about, "delta_t": np.float64(task.dt_s or 0.0)}
    write_vectors(out / "vectors.nc", vectors)
    if evaluation.tracks is not None:
        write_list(out / "tracks.nc", *columns_of(evaluation.tracks.vectors, task.dt_s), timed)
    if vtk:
        write_vtk(out / "vectors.vtk", vectors)
    summary: dict[str, Any] = {
        **about,
        **frame_names(task.frames),
        "note": task.note,
        "dt_s": task.dt_s,
        "no_map_sigma": evaluation.no_map_sigma,
    }
    summary |= {"readings": dict(task.readings)} if task.readings else {}  # as it is, in place of the text
    summary |= {"vectors": field.counts, "nan_pixels": field.nan_pixels, "doubt": field.warning}
    summary["correlation"] = asdict(evaluation.settings)
    if np.isfinite(field.static_share):
        summary["static_share"] = field.static_share
    summary["sigma_px"] = sigma_table(evaluation).records()
    summary["sigma_claims"] = claim_table(evaluation).records()
    summary["sigma_verdict"] = sigma_verdict(evaluation)
    if evaluation.shift is not None:
        summary["shift"] = evaluation.shift.to_dict()
    if evaluation.tracks is not None:
        summary["tracks"] = track_summary(evaluation)
    if evaluation.no_tracks:
        summary["no_tracks"] = evaluation.no_tracks
    write_json(out / "evaluation.json", summary)


def write_pair_page(evaluation: Evaluation, figures: bool = False) -> None:
    """Write the page of a pair, with the figures on request also as files; it names what is there."""
    from daq.runs.run_views import tells_a_scale_alone
    from rtpiv.analysis.report.page import Link, Page, behind_glass
    from rtpiv.analysis.report.pair import pair_chapters, pair_summary

    task, out, about = evaluation.task, evaluation.task.out, evaluation.about
    page = Page(f"PIV{behind_glass(task.scene)}: {task.name}", about["frames"], twice=figures)
    pair_summary(page, evaluation)
    pair_chapters(page, evaluation)
    names = ("vectors.nc", "tracks.nc", "vectors.vtk", "evaluation.json")
    page.heading("Files")
    page.links([Link(name, name) for name in names if (out / name).is_file()])
    page.heading("Provenance")
    bodies = [body.name for body in task.scene.bodies]
    said = ", ".join(bodies[:MOST_BODIES]) + (
        f" and {len(bodies) - MOST_BODIES} more" if len(bodies) > MOST_BODIES else ""
    )
    known = {
        name: value for name, value in about.items() if name != "scene_hash" or not tells_a_scale_alone(task.scene)
    }
    page.facts([*known.items(), *([("bodies", said)] if bodies else [])])
    page.write(out / "report.html")
