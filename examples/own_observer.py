"""Your own observer: a model of a person who takes every contact for an attack.

python examples/own_observer.py

Here videos and raters are made up. With those of a study it is
events = ppl.load_events("videos.json"), and ppl.fit_people(events, "study.csv", timid).
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array

import phase_ppl as ppl


def timid(evidence: ppl.observers.Evidence) -> dict[str, Array]:
    weight = numpyro.sample("weight", dist.LogNormal(0.0, 1.0))
    fear = numpyro.sample("fear", dist.HalfNormal(3.0))
    belief = weight * evidence.log_likelihood[0, 0] + evidence.log_prior
    belief += fear * ppl.observers.tilt(evidence, evidence.cues["contact"], adversarial=1.0)
    return {"relation": ppl.observers.log_shares(jnp.asarray(belief), evidence, "relation")}


def judged_events(n: int) -> tuple[list[ppl.Event], dict[str, ppl.Prediction]]:
    """Return events with made-up judgments, and a made-up model's predictions."""
    rng = np.random.default_rng(0)
    bundled = [ppl.load_event(name) for name in ppl.bundled_events()]
    events, model = [], {}
    for i in range(n):
        event = bundled[i % len(bundled)]
        shares = rng.dirichlet([0.7, 0.7, 0.7])
        apart = np.subtract(*event.observation.positions[:, :2].swapaxes(0, 1))
        fear = 0.6 * (np.linalg.norm(apart, axis=1).min() < 2.5)  # if the agents come close
        votes = rng.multinomial(15, (1 - fear) * shares + fear * np.array([0, 0, 1]))
        counts = dict(zip(("friendly", "neutral", "adversarial"), votes.tolist(), strict=True))
        judgments = {"relation_counts": counts}
        events.append(dataclasses.replace(event, id=f"video{i}", judgments=judgments))
        model[f"video{i}"] = ppl.Prediction(f"video{i}", {"relation": shares})
    return events, model


def main() -> None:
    events, model = judged_events(24)
    fit = ppl.fit_people(
        events, None, timid, source=ppl.evidence_from(events, model), draws=60, warmup=60, chains=1
    )
    print(fit)
    for name, answers in (("the model", model), ("timid", fit.left_out)):  # fitted on the others
        found = ppl.evaluate_predictions(events, answers)["human"]
        print(f"{name}: r = {found['relation_r']['value']:.2f} with people")


if __name__ == "__main__":
    main()
