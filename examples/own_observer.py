"""An observer of one's own, who takes every contact for an attack, beside ready-made ones.

python examples/own_observer.py [--quick]

The videos and their raters are made up here, as those of a study would come from its files:
events = ppl.load_events("videos.json"), and ppl.fit_people(events, "study.csv", timid).
"""

from __future__ import annotations

import argparse

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

import phase_ppl as ppl
from phase_ppl.models.observers import Evidence, Responses, log_shares, tilt
from phase_ppl.world.event import Event


def timid(evidence: Evidence) -> Responses:
    weight = numpyro.sample("weight", dist.LogNormal(0.0, 1.0))
    fear = numpyro.sample("fear", dist.HalfNormal(3.0))
    belief = weight * evidence.log_likelihood[0, 0] + evidence.log_prior
    belief += fear * tilt(evidence, evidence.cues["contact"], adversarial=1.0)
    return {"relation": log_shares(jnp.asarray(belief), evidence, "relation")}


def judged_events(n: int) -> tuple[list[Event], dict[str, ppl.Prediction]]:
    """Return events with made-up judgments, and what a made-up model says of them."""
    rng = np.random.default_rng(0)
    bundled = [ppl.load_event(name) for name in ppl.bundled_events()]
    events, model = [], {}
    for i in range(n):
        event = bundled[i % len(bundled)]
        shares = rng.dirichlet([0.7, 0.7, 0.7])
        votes = rng.multinomial(15, 0.7 * shares + 0.3 * np.array([0.2, 0.2, 0.6]))
        counts = dict(zip(("friendly", "neutral", "adversarial"), votes.tolist(), strict=True))
        events.append(
            Event(
                event.scene, event.observation, f"video{i}", judgments={"relation_counts": counts}
            )
        )
        model[f"video{i}"] = ppl.Prediction(f"video{i}", {"relation": shares})
    return events, model


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer draws")
    draws = 100 if parser.parse_args().quick else 500
    events, model = judged_events(24)
    evidence = ppl.evidence_from(events, model)
    fits = {
        name: ppl.fit_people(events, None, observer, source=evidence, draws=draws, warmup=draws)
        for name, observer in {"timid": timid, "saturating": "saturating"}.items()
    }
    for name, fit in fits.items():
        found = ppl.evaluate_predictions(events, fit.left_out)["human"]
        print(f"{name}: r = {found['relation_r']['value']:.2f}, ELPD {fit.elpd.sum():.1f}")
    gain = fits["timid"].elpd - fits["saturating"].elpd
    error = gain.std(ddof=1) * np.sqrt(len(gain))
    print(f"timid explains people by {gain.sum():.1f} nats more than saturating, error {error:.1f}")


if __name__ == "__main__":
    main()
