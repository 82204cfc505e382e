"""Which observer answers as people do about the real videos? Do its parameters come back?

    python benchmarks/people.py fit --source NAME=DIR ... [--observer NAME ...] [--json FILE]
    python benchmarks/people.py store --source NAME=DIR ... --observer NAME [--json FILE]
    python benchmarks/people.py recover [--like prior|people] [--figure FILE] [--json FILE]

``fit`` fits observers to people's answers. A source is a folder with evaluations of the real
videos (``phase-ppl evaluate dev.json --model NAME --out DIR``), a model whose answers the videos
carry, or "cues" for no evidence. Each video is predicted by fits without it. "chosen" picks for
each video the observer that predicts the others best.

``store`` writes the parameters that come with the package.

``recover`` draws raters from known observers and fits them. With ``--like prior`` parameters are
drawn from the priors, and intervals should hold at their rate. With ``--like people`` they are
those found for real people, as far as the observer has them, and the videos have the cues of the
real ones. Of observers that predict about as well, the simplest is chosen (``PARSIMONY``).
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np

import phase_ppl as ppl
from phase_people.answers import Answers, people
from phase_people.fit import PEOPLE, PeopleFit
from phase_people.observers import OBSERVERS, Evidence, observer_named
from phase_ppl.analysis.figures.style import COLOURS, NORMAL, in_style, new_figure, written
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.metrics import evaluate_predictions
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.picture import plain

CHAINS = 4  # of each fit of "recover"
LABELLED = 0.9
"""Probability of the answer of a model that gives labels only."""


def sources(events: list[Event], given: list[str]) -> dict[str, tuple[Evidence, dict[str, Any]]]:
    """Return name -> evidence and the model's own predictions."""
    found: dict[str, tuple[Evidence, dict[str, Any]]] = {}
    for text in given:
        name, _, folder = text.partition("=")
        if folder:
            evaluation = Evaluation.load(folder)
            found[name] = ppl.evidence_from(events, evaluation), dict(evaluation.predictions)
        elif name == "cues":
            even = {e.id: ppl.Prediction(e.id, {"relation": np.full(3, 1 / 3)}) for e in events}
            found[name] = ppl.evidence_from(events, None), even
        else:
            own = {k: with_shares(v) for k, v in reference_predictions(events)[name].items()}
            found[name] = ppl.evidence_from(events, own), own
    return found


def with_shares(given: Prediction) -> Prediction:
    if "relation" in given.probabilities:
        return given
    rest = (1 - LABELLED) / (len(RELATIONS) - 1)
    shares = [LABELLED if one == given.answers["relation"] else rest for one in RELATIONS]
    return ppl.Prediction(given.event_id, {"relation": np.array(shares)}, given.answers)


def scores(events: list[Event], predictions: Mapping[str, Prediction]) -> dict[str, Any]:
    metrics = evaluate_predictions(events, predictions)
    doubt = metrics["doubt"] or {}
    return {
        "r": doubt["relation_r"],
        "r_given_truth": doubt["relation_r_given_truth"],
        "log_score": metrics["human"]["log_score"],
        "relation_accuracy": metrics["relation_accuracy"],
        **{name: doubt[name] for name in ("brier", "ece", "calibration")},
    }


def fit(options: argparse.Namespace) -> dict[str, Any]:
    events = [e for e in common.dev_events() if e.judgments]
    report: dict[str, Any] = {}
    if options.json and Path(options.json).is_file():
        report = json.loads(Path(options.json).read_text())
    for name, (evidence, own) in sources(events, options.source).items():
        done = report.setdefault(name, {"as it is": plain(scores(events, own))})
        show(name, "as it is", done["as it is"])
        fits: dict[str, PeopleFit] = {}
        for observer in options.observer:
            one = ppl.fit_people(
                events, None, observer, source=evidence, draws=options.draws, warmup=options.draws,
                chains=options.chains,
            )  # fmt: skip
            fits[observer] = one
            done[observer] = plain(
                {
                    **scores(events, one.left_out),
                    "elpd": one.elpd.sum(),
                    "elpd_by_event": one.elpd,
                    "refitted": int((one.pareto_k > 0.7).sum()),
                    "parameters": {
                        k: {"mean": v.mean(), "sd": v.std()} for k, v in one.draws.items()
                    },
                }
            )
            show(name, observer, done[observer])
            keep(options, report)
        if len(fits) > 1:
            predictions, chosen = chosen_inside(list(fits.values()))
            names = list(fits)
            done["chosen"] = plain(scores(events, predictions))
            done["chosen"]["observers"] = {e: names[place] for e, place in chosen.items()}
            show(name, "chosen", done["chosen"])
        keep(options, report)
    return report


def show(name: str, observer: str, found: Mapping[str, Any]) -> None:
    cells = [
        f"{part} {common.shown(one, '6.3f')}"
        for part in ("r", "r_given_truth", "log_score", "relation_accuracy")
        if (one := found[part])
    ]
    elpd = f"  elpd {found['elpd']:.1f}" if "elpd" in found else ""
    print(f"{name:16s}{observer:12s}" + "  ".join(cells) + elpd, flush=True)


def keep(options: argparse.Namespace, report: Mapping[str, Any]) -> None:
    if options.json:
        Path(options.json).write_text(json.dumps(report))


def store(options: argparse.Namespace) -> dict[str, Any]:
    """Fit to all videos, and return what ``people.json`` holds."""
    events = [e for e in common.dev_events() if e.judgments]
    report = {}
    for name, (evidence, _) in sources(events, options.source).items():
        fitted = ppl.fit_people(
            events, None, options.observer[0], source=evidence, draws=options.draws,
            warmup=options.draws, chains=options.chains,
        )  # fmt: skip
        report["chance" if name == "cues" else name] = fitted.to_dict()
        print(name, {k: f"{v.mean():.2f} ± {v.std():.2f}" for k, v in fitted.draws.items()})
    keep(options, report)
    return report


# --- do parameters and observers come back? -------------------------------------------------------


RIVALS = ("saturating", "company", "attentive")
"""From the simplest to the one with most parameters, each a case of the next."""

PARSIMONY = 1.0
"""Standard errors of a difference in ELPD within which the simpler observer is preferred."""

NOBODY: Any = np.zeros((0, 4), np.int64), (), np.zeros((0, 2), np.int64), np.zeros(0)
"""Of answers without names."""


def videos_like(rng: np.random.Generator, n: int, cues: Mapping[str, FloatArray]) -> Evidence:
    """Return evidence on ``n`` videos, spread about as that on the real ones is.

    With ``cues``, or where there are none with made-up ones.
    """
    true = rng.integers(len(RELATIONS), size=n)
    logs = rng.normal(0.0, 1.5, (n, len(RELATIONS)))
    logs[np.arange(n), true] += rng.gamma(2.0, 2.0, n)
    logs -= logs.max(axis=1, keepdims=True)
    return Evidence(
        tuple(f"video{i}" for i in range(n)),
        np.tile(logs, (3, 1, 1, 1)),
        np.full((n, len(RELATIONS)), -np.log(len(RELATIONS))),
        {"relation": np.arange(len(RELATIONS))},
        cues
        or {
            "distance": rng.normal(0.2, 0.5, n),
            "contact": np.clip(rng.gamma(0.7, 0.35, n), 0, 1),
            "working": rng.uniform(0, 0.6, n),
            "impact": rng.gamma(1.5, 0.4, n),
        },
    )


@functools.cache
def real_cues() -> Mapping[str, FloatArray]:
    """Return the surface cues of the real videos."""
    return ppl.evidence_from(common.dev_events(), None).cues


def population(
    name: str, rng: np.random.Generator, like: str, videos: int, raters: int
) -> tuple[Evidence, Answers, dict[str, float]]:
    """Return evidence, answers of raters who follow an observer, and its parameters."""
    import jax
    from numpyro import handlers

    real: dict[str, float] = {}
    cues: dict[str, FloatArray] = {}
    if like == "people":
        known = ppl.FittedObserver.named(PEOPLE, "closed_loop").draws
        draw = int(rng.integers(len(known["spread"])))
        real = {k: float(values[draw]) for k, values in known.items()}
        seen = real_cues()
        places = rng.permutation(np.resize(np.arange(len(seen["contact"])), videos))
        cues = {k: values[places] for k, values in seen.items()}
    evidence = videos_like(rng, videos, cues)
    with (
        handlers.seed(rng_seed=int(rng.integers(2**31))),
        handlers.substitute(data=real),
        handlers.trace() as trace,
    ):
        said = observer_named(name)(evidence)
    true = {k: float(site["value"]) for k, site in trace.items() if not k.startswith("raw_")}
    true["spread"] = real.get("spread", float(abs(rng.normal(0.0, 1.0))))
    logs = np.asarray(said["relation"]) + true["spread"] * rng.standard_normal((videos, 3))
    p = np.asarray(jax.nn.softmax(logs, axis=-1), np.float64)
    counts = rng.multinomial(raters, p / p.sum(axis=1, keepdims=True)).astype(float)
    return evidence, Answers({"relation": counts}, *NOBODY), true


@functools.cache
def sampler(name: str, draws: int) -> Any:
    """Return a sampler for one observer, compiled once for all populations."""
    from numpyro.infer import MCMC, NUTS

    def program(logs: Any, cues: Any, counts: Any) -> None:
        n = len(counts)
        prior, codes = np.full(counts.shape, -np.log(len(RELATIONS))), np.arange(len(RELATIONS))
        evidence = Evidence(("",) * n, logs, prior, {"relation": codes}, cues)
        people(observer_named(name), evidence, Answers({"relation": counts}, *NOBODY), np.ones(n))  # type: ignore[arg-type]

    # weight and saturation have two modes, of which a single chain sees one
    return MCMC(
        NUTS(program, target_accept_prob=0.9, max_tree_depth=5), num_warmup=draws,
        num_samples=draws, num_chains=CHAINS, chain_method="vectorized", progress_bar=False,
        jit_model_args=True,
    )  # fmt: skip


def drawn(
    name: str, evidence: Evidence, answers: Answers, options: argparse.Namespace, seed: int
) -> dict[str, Any]:
    import jax

    mcmc = sampler(name, options.draws)
    data = evidence.log_likelihood, dict(evidence.cues), answers.counts["relation"]
    mcmc.run(jax.random.key(seed), *data)
    return {k: np.asarray(v, np.float64) for k, v in mcmc.get_samples().items()}


def left_out_scores(log_likelihood: Any) -> FloatArray:
    """Return (video,) the log predictive density of each video's answers without them."""
    weights, _ = ppl.pareto_smoothed(-log_likelihood.T)
    return np.asarray(np.logaddexp.reduce(np.log(weights) + log_likelihood.T, axis=1))


def simplest(elpd: Mapping[str, FloatArray]) -> str:
    """Return the simplest observer that is not surely worse than the best one."""
    best = max(elpd, key=lambda rival: elpd[rival].sum())
    for rival in RIVALS:
        behind = elpd[best] - elpd[rival]
        if behind.sum() <= PARSIMONY * behind.std() * len(behind) ** 0.5:
            return rival
    return best


def recover(options: argparse.Namespace) -> dict[str, Any]:
    asked = {name: getattr(options, name) for name in ("like", "videos", "raters", "draws", "seed")}
    rows = already(options.json, asked)
    for i in range(len(rows), options.populations):
        rng = np.random.default_rng([options.seed, i])
        name = RIVALS[i % len(RIVALS)]
        evidence, answers, true = population(
            name, rng, options.like, options.videos, options.raters
        )
        fits = {rival: drawn(rival, evidence, answers, options, i) for rival in RIVALS}
        scores = {rival: left_out_scores(one["log_likelihood"]) for rival, one in fits.items()}
        elpd = {rival: float(one.sum()) for rival, one in scores.items()}
        best, chosen = max(elpd, key=lambda rival: elpd[rival]), simplest(scores)
        parameters = {}
        for site in true:
            draws = fits[name][site]
            low, high = np.quantile(draws, [0.05, 0.95])
            rank = float((draws < true[site]).mean())
            parameters[site] = {
                "true": true[site], "mean": float(draws.mean()), "low": float(low),
                "high": float(high), "rank": rank,
            }  # fmt: skip
        rows.append(
            {
                "observer": name,
                "best": best,
                "chosen": chosen,
                "elpd": elpd,
                "parameters": parameters,
            }
        )
        inside = [p["low"] <= p["true"] <= p["high"] for p in parameters.values()]
        print(
            f"{i:3d} {name:12s} best {best:12s} chosen {chosen:12s} inside 90 %: {sum(inside)} of "
            f"{len(inside)}",
            flush=True,
        )
        keep(options, {"asked": asked, "populations": rows})
    report = {"asked": asked, "populations": rows, **summary(rows)}
    print({k: v for k, v in report.items() if k != "populations"})
    if options.figure:
        draw(rows, options.figure)
    keep(options, report)
    return report


def already(path: str | None, asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the populations of an earlier run of ``asked`` that ``path`` keeps."""
    if not path or not Path(path).exists():
        return []
    kept: dict[str, Any] = json.loads(Path(path).read_text())
    if kept.get("asked") != asked:
        raise SystemExit(f"{path} keeps another run: {kept.get('asked')}, not {asked}")
    return list(kept["populations"])


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    inside = [
        p["low"] <= p["true"] <= p["high"] for row in rows for p in row["parameters"].values()
    ]
    return {
        "right_best": sum(row["observer"] == row["best"] for row in rows),
        "right_chosen": sum(row["observer"] == row["chosen"] for row in rows),
        "of": len(rows),
        "coverage_of_90": float(np.mean(inside)),
        "intervals": len(inside),
    }


@in_style
def draw(rows: list[dict[str, Any]], path: str) -> None:
    """Draw true against inferred parameters, one panel each."""
    names = sorted({site for row in rows for site in row["parameters"] if "raw" not in site})
    n_rows = -(-len(names) // 5)
    figure = new_figure(9.0, 1.9 * n_rows)
    for axes, name in zip(figure.subplots(n_rows, 5, squeeze=False).flat, names, strict=False):
        of = [row["parameters"][name] for row in rows if name in row["parameters"]]
        for p in of:
            inside = p["low"] <= p["true"] <= p["high"]
            colour = COLOURS[0] if inside else COLOURS[1]
            axes.plot([p["true"]] * 2, [p["low"], p["high"]], color=colour, lw=1)
            axes.plot(p["true"], p["mean"], "o", ms=3, color=colour)
        ends = [min(p["true"] for p in of), max(p["true"] for p in of)]
        axes.plot(ends, ends, color="#999999", lw=0.7)
        axes.set_title(name, fontsize=NORMAL)
    for axes in figure.axes[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel("true", fontsize=NORMAL)
    figure.supylabel("inferred, with 90 % interval", fontsize=NORMAL)
    written(figure, path)


def chosen_inside(fits: Sequence[PeopleFit]) -> tuple[dict[str, Prediction], dict[str, int]]:
    """Predict each video by the fit that predicts the OTHER videos best without this one.

    So the choice of an observer does not see the video that judges it. Draws are reweighted to
    leave that video out, and then each other video in turn. Also returns event id -> place of the
    chosen fit.
    """
    n = len(fits[0].evidence.events)
    without = np.array([_elpd_without(fit) for fit in fits])  # fit, left out, event
    judged = fits[0].answers.judged > 0
    best = np.array([without[:, i, judged & (np.arange(n) != i)].sum(axis=1) for i in range(n)])
    chosen = best.argmax(axis=1)
    names = fits[0].evidence.events
    return (
        {name: fits[k].left_out[name] for name, k in zip(names, chosen, strict=True)},
        dict(zip(names, chosen.tolist(), strict=True)),
    )


def _elpd_without(fit: PeopleFit) -> FloatArray:
    """Return (left out, event) log predictive densities of events, both left out."""
    logs = fit.log_likelihood.T
    found = np.empty((len(logs), len(logs)))
    for i, one in enumerate(logs):
        weights, _ = ppl.pareto_smoothed(-logs - one)
        found[i] = np.logaddexp.reduce(np.log(weights) + logs, axis=1)
    return found


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("what", choices=("fit", "store", "recover"))
    parser.add_argument("--source", action="append", default=[], metavar="NAME[=DIR]")
    parser.add_argument("--observer", action="append", choices=sorted(OBSERVERS))
    parser.add_argument("--like", choices=("prior", "people"), default="prior")
    parser.add_argument("--populations", type=int, default=20)
    parser.add_argument("--videos", type=int, default=50)
    parser.add_argument("--raters", type=int, default=14)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--chains", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", metavar="FILE")
    options = parser.parse_args()
    options.observer = options.observer or list(RIVALS)
    {"fit": fit, "store": store, "recover": recover}[options.what](options)


if __name__ == "__main__":
    main()
