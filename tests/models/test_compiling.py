"""Compilation of small programs."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import pytest

from phase_ppl.models import density


@pytest.fixture(autouse=True)
def _asked_anew() -> Iterator[None]:
    density._known_options.cache_clear()
    yield
    density._known_options.cache_clear()


def test_options_that_this_version_does_not_know_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = dict(density._WANTED)
    monkeypatch.setattr(density, "_WANTED", {"xla_no_such_option": True, **known})
    assert density.compiled_quickly(lambda x: 2 * x)(jnp.float32(3.0)) == 6.0
    assert "xla_no_such_option" not in density._known_options()
    assert density._known_options()
    assert density._known_options().items() <= known.items()
