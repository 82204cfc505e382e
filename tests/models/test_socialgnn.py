"""SocialGNN: the graphs of frames, what the network can learn, and its files."""

from __future__ import annotations

import contextlib
import dataclasses
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.models.socialgnn import store
from phase_ppl.models.socialgnn.graphs import (
    NEAR,
    VARIANTS,
    Graphs,
    Variant,
    batch,
    edge_slots,
    example,
    frame_graphs,
    touching,
)
from phase_ppl.models.socialgnn.store import Trained, TrainingSettings, shapes
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.scene import Scene
from tests.models.walks import eight, needs_torch, walk
from tests.world.examples import walls

with contextlib.suppress(ImportError):  # an extra
    import torch

    from phase_ppl.models.socialgnn.network import Ensemble, SocialGNN, fit

SETTINGS = TrainingSettings(epochs=60, batch=8, learning_rate=0.02, decay=0.0)


BRINGING = walk(2, 1, n_frames=9, with_item=True)
"""Red brings the blue item to the red landmark."""


def graphs(variant: Variant = "extended", event: Event = BRINGING) -> Graphs:
    return frame_graphs(event.scene, event.observation, variant)


def edges(of: Graphs) -> set[tuple[int, int, int]]:
    return set(map(tuple, of.edges.tolist()))


def test_entities_are_joined_with_the_landmarks_near_them() -> None:
    found = {edge for edge in edges(graphs()) if max(edge[1:]) >= 4}
    positions = BRINGING.observation.positions
    apart = np.linalg.norm(positions[:, :, None] - BRINGING.scene.landmark_centres, axis=-1)
    near = {(frame, entity, 4 + lm) for frame, entity, lm in np.argwhere(apart < NEAR).tolist()}
    assert found == near | {(frame, landmark, entity) for frame, entity, landmark in near}
    assert (8, 0, 4 + 2) in found
    assert (0, 0, 4 + 2) not in found


def test_walls_are_context_and_in_the_original_landmarks_too() -> None:
    both_ends = [16, 12, 16, 22, 16, 12, 11, 12, *[0] * 8]
    np.testing.assert_allclose(graphs("extended").context, both_ends)
    found = graphs("original")
    np.testing.assert_allclose(found.context[:16], both_ends)
    np.testing.assert_allclose(found.context[16:18], [8.5, 19.5])
    assert edges(found) == {edge for edge in edges(graphs()) if max(edge[1:]) < 4}


def test_contact_is_being_near_with_no_wall_between() -> None:
    radius = np.array([0.8, 1.2, 1.01, 0.8])
    start = np.array([[15.0, 16, 0], [17.0, 16, 0], [9.0, 5, 0], [11.1, 5, 0]])
    there = Observation(np.stack([start, start]))
    open_scene, walled = Scene(start, radius), Scene(start, radius, walls(up=10))
    # red and green are 2 apart, within 1.2 (0.8 + 1.2); the items 2.1, within 1.2 * 1.81 = 2.17
    near = touching(open_scene, there)[0]
    assert near[0, 1]
    assert near[1, 0]
    assert near[2, 3]
    assert near.sum() == 4
    apart = touching(walled, there)[0]
    assert not apart[0, 1]
    assert apart[2, 3]
    start[1, 0] = 15 + 2.41
    moved = Observation(np.stack([start, start]))
    assert not touching(open_scene, moved)[0, 0, 1]


@needs_torch
def test_the_lstm_of_the_original_reads_edges_side_by_side_and_zeros() -> None:
    made, found = SocialGNN("original"), graphs("original")
    seen = made._frames(batch([found])).detach().numpy().reshape(9, 12, 64)
    joined = edges(found)
    assert joined
    for frame in range(9):
        for (one, other), slot in np.ndenumerate(edge_slots("original")):
            if (frame, one, other) in joined:
                told = [found.nodes[frame, one], found.nodes[frame, other], found.context]
                wanted = made.edge(torch.from_numpy(np.concatenate(told))).detach().numpy()
                np.testing.assert_allclose(seen[frame, slot], wanted, rtol=1e-3, atol=1e-4)
            elif slot >= 0:
                assert not seen[frame, slot].any()


@needs_torch
@pytest.mark.parametrize("variant", VARIANTS)
def test_it_learns_eight_events_by_heart(variant: Variant) -> None:
    events = eight()
    examples = [example(event, variant) for event in events]
    fitted = fit(examples, examples, dataclasses.replace(SETTINGS, variant=variant), seed=0)
    assert fitted.curves["validation"][-1] < 0.3
    ensemble = Ensemble(Trained(variant, (fitted.arrays,)))
    for number, event in enumerate(events):
        found, wanted = ensemble(event.scene, event.observation), examples[number]
        assert found["relation"].argmax() == wanted.relation
        if variant != "original":
            assert found["goal_red"].argmax() == wanted.goals[0]
            assert found["goal_green"].argmax() == wanted.goals[1]
        else:
            assert set(found) == {"relation"}


@needs_torch
def test_a_seed_makes_one_network_whatever_was_drawn_before() -> None:
    settings = TrainingSettings(epochs=2)
    examples = [example(event, "extended") for event in eight()]
    one = fit(examples, examples, settings, seed=3)
    torch.rand(3)
    threads = torch.get_num_threads()
    again, other = (fit(examples, examples, settings, seed) for seed in (3, 4))
    for name, array in one.arrays.items():
        np.testing.assert_array_equal(array, again.arrays[name])
    assert one.curves == again.curves
    assert any((array != other.arrays[name]).any() for name, array in one.arrays.items())
    assert torch.get_num_threads() == threads


def random_member(variant: Variant, seed: int = 0) -> dict[str, NDArray[np.float16]]:
    rng = np.random.default_rng(seed)
    return store.halved(
        {name: rng.normal(0, 0.3, shape) for name, shape in shapes(variant).items()}
    )


@needs_torch
def test_networks_together_say_the_mean_of_their_probabilities() -> None:
    members = tuple(random_member("extended", seed) for seed in range(3))
    *each, together = (
        Ensemble(Trained("extended", some))(BRINGING.scene, BRINGING.observation)
        for some in (*zip(members, strict=True), members)
    )
    for name, shares in together.items():
        np.testing.assert_allclose(shares, np.mean([one[name] for one in each], axis=0))


@needs_torch
def test_an_event_of_any_length_gets_the_answer_that_it_gets_among_others() -> None:
    ensemble = Ensemble(Trained("extended", (random_member("extended"),)))
    events = [walk(2, 0, 3), walk(1, 0, 150, with_item=True), walk(0, 3, 2)]
    together = batch([frame_graphs(e.scene, e.observation, "extended") for e in events])
    with torch.no_grad():
        said = ensemble._networks[0](together)
    for number, event in enumerate(events):
        alone = ensemble(event.scene, event.observation)
        np.testing.assert_allclose(
            said.relation[number].softmax(-1).numpy(), alone["relation"], atol=1e-5
        )


def test_networks_come_back_bit_by_bit(tmp_path: Path) -> None:
    members = [random_member("extended", seed) for seed in range(2)]
    store.save(members, tmp_path / "extended.npz")
    for source in (tmp_path, tmp_path / "extended.npz"):
        found = store.load(source)
        assert found.variant == "extended"
        np.testing.assert_equal(list(found.members), members)
        assert found.digest() == Trained("extended", tuple(members)).digest()
    assert found.digest() != Trained("extended", tuple(members[:1])).digest()


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("0/lstm.bias_hh_l0", None, r"0/lstm\.bias_hh_l0 has shape None, expected"),
        ("0/more", np.zeros(3, np.float16), r"0/more has shape \(3,\), expected None"),
        ("0/edge.bias", np.zeros(3, np.float16), r"has shape \(3,\), expected \(64,\)"),
        ("0/edge.bias", np.full(64, np.nan, np.float16), "something else than finite numbers"),
        ("0/edge.bias", np.zeros(64), "something else than finite numbers in half"),
        ("7/edge.bias", np.zeros(64, np.float16), "expected members 0, 1, ..., found 0, 7"),
        ("0/edge.bias", np.array([{}] * 64), "Object arrays cannot be loaded"),
    ],
)
def test_a_damaged_file_is_refused(name: str, array: Any, message: str, tmp_path: Path) -> None:
    arrays = {f"0/{n}": a for n, a in random_member("original").items()} | {name: array}
    file = tmp_path / "original.npz"
    np.savez(file, **{n: a for n, a in arrays.items() if a is not None})
    with pytest.raises(InvalidSettingError, match=f"original.npz holds no weights.*{message}"):
        store.load(file)


def test_what_is_no_file_of_arrays_is_refused_in_a_line(tmp_path: Path) -> None:
    store.save([random_member("original")], tmp_path / "whole.npz")
    whole = (tmp_path / "whole.npz").read_bytes()
    flipped = bytearray(whole)
    for place in range(200, len(flipped), 97):
        flipped[place] ^= 0xFF
    contents = {"none.npz": b"", "text.npz": b"weights", "half.npz": whole[: len(whole) // 2],
                "flipped.npz": bytes(flipped)}  # fmt: skip
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    header = f"{{'descr': '<f2', 'fortran_order': False, 'shape': {'(' * 3000}"
    with zipfile.ZipFile(tmp_path / "deep.npz", "w") as packed:
        length = len(header).to_bytes(2, "little")
        packed.writestr("0/edge.bias.npy", b"\x93NUMPY\x01\x00" + length + header.encode())
    for name in (*contents, "deep.npz", "missing.npz"):
        with pytest.raises(InvalidSettingError, match=f"{name} holds no weights of a") as told:
            store.load(tmp_path / name)
        assert len(str(told.value)) < 300 + len(str(tmp_path))


def test_files_that_unpack_to_much_and_numbers_too_large_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("0/edge.bias.npy", bytes(10**8))
    with pytest.raises(InvalidSettingError, match="unpacks to more than 67108864"):
        store.load(tmp_path / "bomb.npz")
    with pytest.raises(InvalidSettingError, match="edge holds something else than finite"):
        store.halved({"edge": np.array([1e6])})
