"""Data sets made on a dask cluster: the same bytes, also where a worker is killed."""

from __future__ import annotations

import functools
import os
import time
from pathlib import Path

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.hypothesis import Roles
from phase_ppl.world.scene import World
from tests.dataset.generation.test_any_world import QUICK
from tests.simulator.clusters import local_cluster, note, processes, the_third_killed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills a process")
