"""Drawn plants in parallel: other workers, the same numbers; a Dask cluster takes them where there is one."""

import sys

import joblib
import pytest

from micromanip.design.cluster import cluster
from micromanip.design.loops import each
from micromanip.errors import DeviceUnavailable, UsageError


def square(seed):
    return seed * seed


def test_results_come_in_the_order_of_the_seeds():
    with joblib.parallel_config(backend="threading"):
        assert list(each(square, range(20), 3)) == [seed * seed for seed in range(20)]


@pytest.mark.filterwarnings("ignore")
def test_a_local_dask_cluster_takes_the_work(monkeypatch):
    distributed = pytest.importorskip("distributed")
    local = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
    )
    with local:
        seen = []
        with cluster(local.scheduler_address):
            seen = list(each(worker_of, range(12), None))
        assert [seed for seed, _ in seen] == list(range(12))
        assert all(address.startswith("tcp://127.0.0.1") for _, address in seen), "the work was done by the workers"


def worker_of(seed):
    from distributed import get_worker

    return seed, get_worker().address


@pytest.mark.filterwarnings("ignore")
def test_drawn_plants_are_the_same_on_a_cluster():
    distributed = pytest.importorskip("distributed")
    from micromanip.design.loops import monte_carlo

    from .test_perturbation import PERIOD_S, sides

    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
        ) as local,
        cluster(local.scheduler_address),
    ):
        there = list(monte_carlo(*sides(), PERIOD_S, range(3)))
    assert there == list(monte_carlo(*sides(), PERIOD_S, range(3), 1))


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"micromanip\[cluster\]"), cluster("tcp://127.0.0.1:8786"):
        pass


def test_an_address_that_is_none_is_said_at_once():
    pytest.importorskip("distributed")
    with pytest.raises(DeviceUnavailable, match="no Dask scheduler answers at nonsense:"), cluster("nonsense://x"):
        pass
