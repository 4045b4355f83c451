"""Work in parallel: other workers, the same results; a Dask scheduler takes it where there is one."""

import os
import signal

import joblib
import pytest

from micromanip.design.analyse.loops import monte_carlo
from micromanip.design.parallel import each, scheduler
from micromanip.errors import DeviceUnavailable
from tests.design.analyse.test_loops import PERIOD_S, sides


def square(seed):
    return seed * seed


def die(seed):
    os.kill(os.getpid(), signal.SIGKILL)


def test_results_come_in_the_order_of_the_items():
    with joblib.parallel_config(backend="threading"):
        assert list(each(square, range(20), 3)) == [seed * seed for seed in range(20)]


@pytest.mark.live
@pytest.mark.filterwarnings("ignore")  # a process that is killed closes nothing
def test_a_killed_process_is_one_message():
    with pytest.raises(DeviceUnavailable, match="a worker process was killed"):
        list(each(die, range(4), 2))


@pytest.mark.filterwarnings("ignore")
def test_drawn_plants_are_the_same_on_a_cluster():
    distributed = pytest.importorskip("distributed")
    local = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
    )
    with local, scheduler(local.scheduler_address):
        there = list(monte_carlo(*sides(), PERIOD_S, range(3)))
        addresses = list(each(worker_of, range(6)))
    assert there == list(monte_carlo(*sides(), PERIOD_S, range(3), 1))
    assert all(address.startswith("tcp://127.0.0.1") for address in addresses), "the workers did the work"


def worker_of(seed):
    from distributed import get_worker

    return get_worker().address


def test_an_address_that_is_none_is_said_at_once():
    pytest.importorskip("distributed")
    with pytest.raises(DeviceUnavailable, match="no Dask scheduler answers at nonsense:"), scheduler("nonsense://x"):
        pass
