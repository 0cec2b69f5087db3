"""What all tests share: how examples are drawn, in which order files run, and how the garbage collector is set.

Drawn examples are judged by their results, never by how long a busy machine took.
"""

import gc
import os
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from rtpiv.command_line import first_use

first_use.MOST_HELPERS = 0  # all cores have tests

# Programs of other projects that bench files of tests name; what is asked of a person is tested with none of them.
TRUSTED = (
    "builtins:dict", "tests.daq.bench.test_devices:LampKind",
    "hangs:Hangs", "math:sqrt", "no.such.module:Camera", "no.such:Thing", "no_such_core:Core",
    "nowhere.at.all:Axis", "nowhere:Lamp", "ophyd.sim:SynAxis", "sim.camera.core:Untrue",
    "tests_own_axes:TimedAxis",
)  # fmt: skip
os.environ["RTPIV_TRUST"] = ",".join(TRUSTED)
os.environ.setdefault("RTPIV_THREADS", "1")  # all cores have tests
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it; NumPy is not imported yet

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# Under nohup or in the background of a script, as CI may be: programs inherit what is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
for name in {"SIGHUP", "SIGQUIT", "SIGTSTP"} & set(dir(signal)):
    signal.signal(getattr(signal, name), signal.SIG_DFL)


def pytest_xdist_auto_num_workers() -> int:
    """Two processes more than cores: a third of the time a test waits for a program, a port or a disk."""
    return (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1) + 2


# The files that take longest begin: they are handed out in order (--no-loadscope-reorder), and the last are short.
# Those that compile what another file asks for as well begin long before it: two processes would compile it twice.
LONG = (
    "tracer/test_walls.py", "test_behind_window.py", "test_hard_scenes.py", "test_find_sheet.py",
    "test_report.py", "test_light_height.py", "test_ensemble.py", "test_blocks.py", "test_init.py",
    "cameras/test_contract.py", "test_board_search.py", "test_laser_trials.py", "test_restarts.py",
    "test_runner.py", "test_balls.py", "test_run_series.py", "test_what_the_system_refuses.py", "test_rays.py",
    "test_harvesters.py", "test_correction_map.py", "test_streams.py", "test_flows.py",
    "test_person_at_the_box.py", "test_model_verdict.py", "live/test_page.py", "test_stops.py",
    "test_calibrate.py", "test_stop_signals.py", "test_lens_fit.py", "test_makers_plates.py",
    "test_laser_prove.py", "test_shells.py", "test_without_a_scale.py", "test_names_of_files.py",
    "test_reference.py", "stages/test_contract.py", "test_series_verbs.py", "test_ended_programs.py",
    "test_budget.py", "test_view_agreement.py",
)  # fmt: skip


SLOW_S = 3600.0  # what hangs is ended; what waits for a busy core is not


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Long files first, all else in its order; a slow test is not judged by how long a busy machine takes."""
    items.sort(key=lambda item: _turn(item.path))
    is_posix = os.name == "posix" and not config.pluginmanager.has_plugin("tests.no_posix.plugin")
    for item in items:
        if not is_posix and (only := item.get_closest_marker("posix")):
            item.add_marker(pytest.mark.skip(reason=f"POSIX alone: {only.args[0]}"))
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Let the collector rest while tests are collected, which lets nothing go: it took a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """Let the collector leave alone what stays, and rest longer: it took a twentieth of all time."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@cache
def _turn(path: Path) -> int:
    """Place of a file among those that take long; all others come behind them."""
    return next((turn for turn, name in enumerate(LONG) if path.as_posix().endswith(f"/{name}")), len(LONG))
