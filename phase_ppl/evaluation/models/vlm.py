"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro")."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.identity import qualified_name

if TYPE_CHECKING:
    from phase_ppl.evaluation.vlm.model import Vlm
    from phase_ppl.evaluation.vlm.request import Client


@register_model("vlm", parallel=False, extra="vlm")  # one request at a time: services count them
def vlm(
    *,
    client: str | Client | None = None,
    name: str | None = None,
    store: str | os.PathLike[str] | None = None,
    replay: bool = False,
    show: str | None = None,
    frames: int = 24,
    base_url: str | None = None,
    key_env: str | None = None,
    temperature: float | None = None,
    video_fps: float | None = None,
    timeout: float | None = None,
    retries: int = 4,
    remaining: str = "spread",
) -> Vlm:
    """A vision-language model that watches the animation and answers in JSON.

    Args:
        client: "google", "openai" (or whatever speaks the same), or a function that takes a
            :class:`~phase_ppl.evaluation.vlm.request.Request` and returns a text.
        name: of the model, as the service calls it; for Google the paper's, gemini-2.5-pro. For a
            function, the name under which its answers are kept, by default its own.
        store: folder in which answers are kept; one that is there is not asked for again.
        replay: ask nobody; an answer that is not in ``store`` is an error.
        show: "video" or "pictures"; by default the video to Google and to functions, pictures to
            OpenAI's API, which takes no video. A function may look at both; this is what the
            prompt speaks of.
        frames: how many pictures, evenly spaced, the first and the last frame among them.
        base_url: of a service that speaks the same; it may need no key.
        key_env: name of the environment variable with the key; by default GOOGLE_API_KEY or
            GEMINI_API_KEY, and OPENAI_API_KEY.
        temperature: by default the service's, as for the paper.
        video_fps: frames per second of the video that Google looks at; by default Google's, 1.
        timeout: seconds for a request to a service, from its beginning to its end; by default 300.
        retries: how often the same request is made again after a failure that may pass or an
            answer that cannot be used.
        remaining: "spread" or "zero" (:data:`phase_ppl.evaluation.vlm.answers.REMAINING`).

    Raises:
        InvalidSettingError, UnknownNameError: one of them cannot be used, or the client's
            library is not installed.
        OutputError: ``store`` is no folder.
    """
    from phase_ppl.evaluation.vlm.answers import REMAINING, Store
    from phase_ppl.evaluation.vlm.model import Vlm
    from phase_ppl.evaluation.vlm.services import make_service

    if client is None:
        raise InvalidSettingError(
            "model 'vlm' needs client='google', client='openai' or a function of a request"
        )
    if not isinstance(replay, bool):
        raise InvalidSettingError(f"replay={shown(replay)}, expected true or false")
    if remaining not in REMAINING:
        raise unknown_name("remaining", remaining, REMAINING)
    if show not in (None, "video", "pictures"):
        raise unknown_name("show", show, ("video", "pictures"))
    if name is not None and not (isinstance(name, str) and name.strip()):
        raise InvalidSettingError(f"name={shown(name)}, expected a name")
    whole_number("frames", frames, minimum=2)
    whole_number("retries", retries, minimum=0)
    kept = None if store is None else Store(store)
    if replay and (kept is None or not any(kept.path.glob("*.json"))):
        where = "store is not given" if kept is None else f"there are none in {kept.path}"
        raise InvalidSettingError(f"replay needs a store with answers, but {where}")
    of_services = {
        "base_url": base_url,
        "key_env": key_env,
        "temperature": temperature,
        "video_fps": video_fps,
        "timeout": timeout,
    }
    given = {option: value for option, value in of_services.items() if value is not None}
    if callable(client):
        if given:
            raise InvalidSettingError(
                f"{', '.join(given)}: for services, not for a function as client"
            )
        who = qualified_name(client)
        if name is None and (not hasattr(client, "__qualname__") or "<lambda>" in who):
            raise InvalidSettingError(
                f"client {who} has no name of its own: give name=, under which its answers are kept"
            )
        asked: Client = client
        named: dict[str, Any] = {"client": who, "model": name or who, "show": show or "video"}
    else:
        service = make_service(client, name, show, given, to_be_asked=not replay)
        asked, named = service, service.named()
    return Vlm(asked, named, frames, named["show"] == "video", kept, replay, retries, remaining)
