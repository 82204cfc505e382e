"""Kernels side by side on what the closed loop has read: the reference is exact."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.inference.table_run import event_of
from phase_ppl.world.errors import InvalidSettingError
from tests.inference.tables import EXACT, NAMES, skewed
from tests.inference.toy import few_goals

COMPARED: dict[str, Any] = {
    "kernels": ["prior_mh", "single_site_mh"],
    "budget": ppl.simulations(6_060),
    "repeats": 3,
    "chains": 60,
    "progress": False,
}


@functools.cache
def compared() -> ppl.Comparison:
    return ppl.compare(EXACT, **COMPARED)


def test_kernels_are_compared_with_what_is_exact() -> None:
    found, said = compared(), compared().settings["reference"]
    assert said["error"] == {"tv_goals": 0, "tv_relation": 0}
    assert said["simulations"] == 0
    for name in NAMES:
        np.testing.assert_allclose(said["marginals"][name], EXACT.marginal(name), atol=1e-9)
    assert "which is exact" in str(found)
    # which mixes faster
    assert found.ranks("tv_relation").index.tolist() == ["prior_mh", "single_site_mh"]
    assert "rank by TV relation: " in str(found)
    assert (found.runs["simulations"] == 6_060).all()
    assert found.runs["tv_goals"].between(1e-3, 0.15).all()
    assert found.runs["r_hat"].between(1, 2).all()
    per_second = found.runs["ess_per_simulation"] * found.runs["simulations"]
    np.testing.assert_allclose(found.runs["ess_per_second"] * found.runs["seconds"], per_second)
    assert all(heading in str(found) for heading in ("R-hat", "ESS a second"))
    # the curve is what shorter runs would have said
    curve = found.curve[found.curve["kernel"] == "prior_mh"]
    first, last = (curve.groupby("repeat")["tv_goals"].nth(at).mean() for at in (0, -1))
    assert first > 2 * last
    assert curve["simulations"].max() == 6_060


def test_the_prior_of_a_model_counts_in_a_comparison(tmp_path: Path) -> None:
    few: dict[str, Any] = {**COMPARED, "kernels": ["prior_mh"], "repeats": 1}
    few["checkpoint"] = tmp_path / "runs.json"
    found = ppl.compare(EXACT, ppl.Model(prior=skewed), **few)
    expected = EXACT.with_prior(skewed).marginal("relation")
    np.testing.assert_allclose(found.settings["reference"]["marginals"]["relation"], expected)
    assert found.runs["tv_relation"][0] < 0.05
    assert "rank" not in str(found), "a single kernel has none"
    other = EXACT.dataset.assign_attrs(settings='{"seed": 7, "model": {}}')
    with pytest.raises(InvalidSettingError, match="made with another read"):
        ppl.compare(ClosedLoopPosterior(other), ppl.Model(prior=skewed), **few)


def test_a_video_is_read_once_for_all_kernels_and_repeats(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: list[int] = []

    def read(event: ppl.Event, model: ppl.Model, seed: int, *options: Any) -> xr.Dataset:
        seen.append(seed)
        return EXACT.dataset

    monkeypatch.setattr("phase_ppl.inference.closed_loop.filtered_frames", read)
    model = ppl.Model(prior=few_goals, likelihood=ppl.ClosedLoopLikelihood(weight=0.5))
    options = {**COMPARED, "repeats": 2, "budget": ppl.simulations(600), "seed": 4}
    options["checkpoint"] = tmp_path / "runs.json"
    for _ in range(2):  # nothing is left to do the second time
        found = ppl.compare(event_of(EXACT), model, **options)
        assert seen == [4]
    assert len(found.runs) == 4
    assert "which is exact" in str(found)
