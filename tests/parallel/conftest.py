"""Fixtures that several files of tests share."""

import pytest
from machines import Machines, until

from odescope.parallel.dask_cluster import open_workers


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    found = Machines(tmp_path_factory.mktemp("machines"))
    yield found
    found.stop()


@pytest.fixture
def cluster(machines):
    """The cluster, with two workers that live."""
    machines.staff(2)
    with open_workers(machines.address) as found:
        until(lambda: found.count == 2)
        yield found
