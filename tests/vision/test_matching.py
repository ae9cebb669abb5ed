import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.types import Features
from vwnav.vision import matching
from vwnav.vision.matching import match, paired_similarity, similarities


def cosine(seed: int, count: int, size: int = 8) -> Features:
    descriptors = np.random.default_rng(seed).normal(size=(count, size)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    return Features(np.zeros((count, 2), np.float32), descriptors, np.zeros(count, np.float32))


def binary(seed: int, count: int) -> Features:
    bits = np.random.default_rng(seed).integers(0, 256, (count, 32), np.uint8)
    return Features(np.zeros((count, 2), np.float32), bits, np.zeros(count, np.float32))


def similarity(a: Features, b: Features) -> np.ndarray:
    if a.descriptors.dtype == np.uint8:
        differing = np.unpackbits(a.descriptors[:, None] ^ b.descriptors[None], axis=2).sum(axis=2)
        return 1.0 - 2.0 * differing / 256.0
    return a.descriptors.astype(float) @ b.descriptors.astype(float).T


def mutual(table: np.ndarray) -> set[tuple[int, int]]:
    rows, columns = table.argmax(axis=1), table.argmax(axis=0)
    return {(i, int(j)) for i, j in enumerate(rows) if columns[j] == i}


@given(seed=st.integers(0, 10_000), n0=st.integers(1, 40), n1=st.integers(1, 60))
def test_matches_are_the_mutual_nearest_ones(seed: int, n0: int, n1: int):
    a, b = cosine(seed, n0), cosine(seed + 1, n1)
    assert {tuple(pair) for pair in match(a, b)} == mutual(similarity(a, b))


@given(seed=st.integers(0, 10_000), chunk=st.integers(1, 17))
def test_chunks_do_not_change_the_matches(seed: int, chunk: int):
    a, b = cosine(seed, 20), cosine(seed + 1, 50)
    whole = match(a, b)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matching, "CHUNK", chunk)
        assert np.array_equal(match(a, b), whole)


def test_binary_matches_are_mutual_and_nearest():
    a, b = binary(1, 40), binary(2, 70)
    table = similarity(a, b)
    for i, j in match(a, b):
        assert table[i, j] == table[i].max() == table[:, j].max()


@pytest.mark.parametrize("make", [cosine, binary])
def test_the_most_similar_pair_comes_first(make):
    a, b = make(3, 50), make(4, 80)
    pairs = match(a, b)
    values = similarity(a, b)[pairs[:, 0], pairs[:, 1]]
    assert np.all(np.diff(values) <= 1e-6)


@pytest.mark.parametrize("make", [cosine, binary])
def test_the_gate_keeps_the_similar_ones(make):
    a, b = make(3, 50), make(4, 80)
    pairs = match(a, b)
    values = similarity(a, b)[pairs[:, 0], pairs[:, 1]]
    gate = float(np.median(values))
    assert len(match(a, b, min_similarity=gate)) == np.count_nonzero(values >= gate)


def test_nothing_matches_nothing():
    assert match(cosine(0, 0), cosine(1, 5)).shape == (0, 2)
    assert match(binary(0, 5), binary(1, 0)).shape == (0, 2)


def test_other_kinds_cannot_be_matched():
    with pytest.raises(ValueError, match="descriptors of one kind"):
        match(cosine(0, 5), binary(0, 5))
    with pytest.raises(ValueError, match="descriptors of one kind"):
        match(cosine(0, 5), cosine(0, 5, 16))


@pytest.mark.parametrize("kind", [np.float32, np.uint8])
def test_the_similarity_of_pairs_is_that_of_all_with_all(kind):
    rng = np.random.default_rng(4)
    first, second = (rng.integers(0, 255, (9, 32)).astype(kind) for _ in range(2))
    if kind is np.float32:
        first, second = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (first, second))
    expected = similarities(first, second).diagonal()
    assert paired_similarity(first, second) == pytest.approx(expected, abs=1e-6)
