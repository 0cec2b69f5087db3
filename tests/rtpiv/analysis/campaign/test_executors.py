"""Workers of a Dask scheduler write the same bytes; what keeps them away is one sentence."""

import importlib.util
import sys
from concurrent.futures import CancelledError

import pytest

from daq.errors import RunInterrupted, RunUsageError
from rtpiv.analysis.campaign import executors
from rtpiv.analysis.campaign.executors import dask_workers, evaluate_elsewhere
from rtpiv.analysis.campaign.merge import merge_campaign
from rtpiv.analysis.campaign.run_campaign import run_campaign
from tests.rtpiv.analysis.campaign.small_campaign import carried_out, content_of, planned, two_runs

needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="distributed: not installed"
)
pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries that are not ours


@needs_dask
@pytest.mark.slow
def test_workers_of_dask_write_the_same_bytes(tmp_path):
    from distributed import LocalCluster

    runs = two_runs(tmp_path)
    here, elsewhere = (planned(tmp_path / name, runs) for name in ("here", "elsewhere"))
    carried_out(here)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        dask_workers(cluster.scheduler_address) as executor,
    ):
        assert run_campaign(elsewhere, executor, evaluate_elsewhere)[1] == 6
    for folder in (here, elsewhere):
        merge_campaign(folder)
    assert content_of(here.path) == content_of(elsewhere.path)


@needs_dask
def test_a_scheduler_that_is_not_there_is_one_sentence(monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_TIMEOUT_S", 0.3)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(RunUsageError, match="no Dask scheduler answers there"), dask_workers(address):
            pass


def test_an_error_of_the_executor_itself_is_an_interrupted_campaign():
    """The command can be given again; errors of the program keep their own classes."""
    with pytest.raises(RunInterrupted, match="CancelledError"), executors._raise_interrupted():
        raise CancelledError
    with pytest.raises(RunUsageError), executors._raise_interrupted():
        raise RunUsageError("given twice")


def test_a_library_that_is_not_installed_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(RunUsageError, match=r"install rtpiv\[cluster\]"), dask_workers("tcp://127.0.0.1:9"):
        pass
