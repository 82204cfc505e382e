"""The services that can be asked, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.evaluation.registry import check_installed
from phase_ppl.evaluation.vlm import google_client, openai_client
from phase_ppl.evaluation.vlm.google_client import MAX_FPS, GoogleClient
from phase_ppl.evaluation.vlm.openai_client import OpenAIClient
from phase_ppl.evaluation.vlm.service import Service, checked_address, checked_variable
from phase_ppl.world.checks import number_or_nan
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name

SERVICES: Final = {"google": "google.genai", "openai": "openai"}
"""Name -> the module that it needs."""

TIMEOUT: Final = 300.0
LONGEST: Final = 86_400.0
"""Seconds."""

MAX_TEMPERATURE: Final = 2.0


def make_service(
    name: object, model: str | None, show: str | None, given: Mapping[str, Any], to_be_asked: bool
) -> Service:
    """Return a service, ready to be asked.

    Args:
        name: one of :data:`SERVICES`.
        model: as the service calls it.
        show: "video", "pictures" or None, as of the model ``vlm``.
        given: those of ``base_url``, ``key_env``, ``temperature``, ``video_fps`` and ``timeout``
            that are not to be as usual.
        to_be_asked: whether its library is needed.

    Raises:
        InvalidSettingError, UnknownNameError: one of them cannot be used.
    """
    if not isinstance(name, str) or name not in SERVICES:
        raise unknown_name("client", name, SERVICES)
    own = "base_url" in given
    settings: dict[str, Any] = {
        "timeout": _number("timeout", given.get("timeout", TIMEOUT), LONGEST, zero=False),
        "needs_key": not own or "key_env" in given,
    }
    if "temperature" in given:
        settings["temperature"] = _number("temperature", given["temperature"], MAX_TEMPERATURE)
    if "video_fps" in given:
        if name != "google" or show == "pictures":
            raise InvalidSettingError("video_fps is for the video that Google gets")
        settings["video_fps"] = _number("video_fps", given["video_fps"], MAX_FPS, zero=False)
    if name == "openai":
        if show == "video":
            raise InvalidSettingError("show='video', but OpenAI's API takes pictures only")
        if model is None:
            raise InvalidSettingError(
                "client 'openai' needs name=, what the service calls the model"
            )
    if to_be_asked:
        check_installed(f"client {name!r}", [SERVICES[name]], "vlm")
    module = google_client if name == "google" else openai_client
    settings["base_url"] = checked_address(given["base_url"]) if own else module.BASE_URL
    settings["variables"] = module.VARIABLES
    if "key_env" in given:
        settings["variables"] = (checked_variable(given["key_env"]),)
    if name == "google":
        return GoogleClient(model=model or google_client.MODEL, show=show or "video", **settings)
    return OpenAIClient(model=str(model), show="pictures", **settings)


def _number(name: str, value: object, most: float, zero: bool = True) -> float:
    """Return ``value`` as a float if it is a number in 0..most."""
    number = number_or_nan(value)
    if 0 <= number <= most and (zero or number > 0):
        return number
    least = ">= 0" if zero else "> 0"
    raise InvalidSettingError(f"{name}={shown(value)}, expected a number {least} and <= {most:g}")
