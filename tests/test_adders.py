"""Adder graphs: each is the matrix it was made from, in integers, and no adder is wider or narrower than its values."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from greygate.compiler import adders
from greygate.compiler.adders import CONSTANT, Graph, search, signed_digits, solve
from greygate.compiler.adders.graph import signed_width
from greygate.compiler.adders.shape import AT_ONCE, _plain, paired
from greygate.errors import InputError

EFFORT = 0.2  # of the solver where any graph will do


@st.composite
def problems(draw):
    """A matrix, widths and constants: zeros, repeats and powers of two as often as anything else."""
    rows, columns = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    bits = draw(st.sampled_from([2, 6, 16, 24]))
    entry = st.one_of(
        st.just(0),
        st.integers(0, bits - 1).map(lambda s: 1 << s),
        st.integers(-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
    )
    weights = np.array(draw(st.lists(entry, min_size=rows * columns, max_size=rows * columns)), dtype=np.int64)
    widths = draw(st.lists(st.integers(2, 20), min_size=columns, max_size=columns))
    constants = draw(st.lists(st.one_of(st.just(0), st.integers(-(1 << 30), 1 << 30)), min_size=rows, max_size=rows))
    return weights.reshape(rows, columns), widths, constants


def corners(graph: Graph) -> np.ndarray:
    """For every node the two inputs that give its least and its greatest value: (2 * nodes, columns)."""
    vectors = graph.vectors(0, graph.columns)[graph.columns :, :-1]
    lo = np.array([least for least, _ in graph.ranges], dtype=object)
    hi = np.array([most for _, most in graph.ranges], dtype=object)
    return np.concatenate([np.where(vectors < 0, hi, lo), np.where(vectors < 0, lo, hi)])


def values(graph: Graph, x: np.ndarray) -> list[int]:
    """Every node for one input, by the meaning of a node's fields and nothing else; no dropped bit may be 1."""
    found = [int(v) for v in x]
    for n in graph.nodes:
        left = n.constant if n.left == CONSTANT else found[n.left] << n.left_shift
        right = n.constant if n.right == CONSTANT else found[n.right] << n.right_shift
        total = left - right if n.subtract else left + right
        assert total % (1 << n.drop) == 0
        found.append(total >> n.drop)
    return found[graph.columns :]


def answers(graph: Graph, x: np.ndarray) -> list[int]:
    """Every row for one input."""
    found = [*(int(v) for v in x), *values(graph, x)]
    rows = [o.constant if o.operand == CONSTANT else found[o.operand] << o.shift for o in graph.outputs]
    return [-v if o.negate else v for v, o in zip(rows, graph.outputs, strict=True)]


def negations(graph: Graph) -> int:
    """Rows that are negated after the last adder."""
    return sum(o.negate for o in graph.outputs)


@settings(max_examples=60)
@given(problems())
def test_a_graph_is_its_matrix(problem):
    weights, widths, constants = problem
    graph = solve(weights, widths, constants, effort=EFFORT)
    assert (graph.matrix() == weights).all()
    x = np.random.default_rng(1).integers(
        -(1 << (np.array(widths) - 1)), 1 << (np.array(widths) - 1), (20, len(widths))
    )
    assert [answers(graph, row) for row in x] == (x.astype(object) @ weights.T.astype(object) + constants).tolist()


@settings(max_examples=40)
@given(problems())
def test_ranges_are_exact(problem):
    weights, widths, constants = problem
    graph = solve(weights, widths, constants, effort=EFFORT)
    x = corners(graph)
    for k, node in enumerate(graph.nodes):
        low, high = values(graph, x[k])[k], values(graph, x[len(graph.nodes) + k])[k]
        assert (low, high) == (node.lo, node.hi)
        assert node.width == min(w for w in range(1, 80) if -(1 << (w - 1)) <= low <= high < 1 << (w - 1))


def test_every_input_of_a_small_graph_stays_within_its_ranges():
    graph = solve(np.array([[3, -5, 7], [11, 13, -3], [-1, 6, 9]]), [3, 3, 3], [5, 0, -7])
    seen = np.array([values(graph, np.array(x)) for x in itertools.product(range(-4, 4), repeat=3)])
    assert seen.min(axis=0).tolist() == [n.lo for n in graph.nodes]
    assert seen.max(axis=0).tolist() == [n.hi for n in graph.nodes]


@settings(max_examples=40)
@given(problems())
def test_operands_stand_before_their_users_and_shifts_are_plain(problem):
    weights, widths, constants = problem
    graph = solve(weights, widths, constants, effort=EFFORT)
    for k, n in enumerate(graph.nodes):
        assert CONSTANT <= n.left < graph.columns + k
        assert CONSTANT <= n.right < graph.columns + k
        assert min(n.left_shift, n.right_shift, n.drop) >= 0
        assert not (n.left == CONSTANT and n.right == CONSTANT)
        assert graph.levels[k] == 1 + max(graph.level(n.left), graph.level(n.right))
        assert n.bits <= n.width + n.drop
    assert all(o.shift >= 0 for o in graph.outputs)
    if all(constants):
        assert negations(graph) == 0  # a constant can always be added so that the sign comes out


def test_a_search_saves_adders():
    weights = np.random.default_rng(3).integers(-(1 << 11), 1 << 11, (6, 6))
    free, quick = solve(weights, [12] * 6), solve(weights, [12] * 6, effort=0)
    assert free.adders < quick.adders < sum(len(signed_digits(int(w))) for w in weights.ravel()) - 6


def test_a_column_of_constants_is_a_graph_of_multiples():
    """5, 45 = 9 * 5 and 225 = 5 * 45: an adder each, where the digits of each alone take six."""
    assert solve(np.array([[5], [45], [225]]), [8]).adders == 3


@pytest.mark.parametrize("weight", [0, 5])
def test_many_constants_beside_few_weights_find_room(weight):
    weights = np.zeros((16, 1), int)
    weights[3] = weight
    assert (solve(weights, [16], constants=[1] * 16).matrix() == weights).all()


def test_wrong_arguments_say_what_to_do():
    for arguments in ({"ranges": [(0, 1)]}, {"constants": [1]}):
        with pytest.raises(InputError, match="give"):
            solve(np.eye(2, dtype=np.int64), [8, 8], **arguments)


def test_the_same_matrix_gives_the_same_graph():
    weights = np.random.default_rng(5).integers(-500, 500, (6, 6))
    assert solve(weights, [12] * 6, [3] * 6, effort=EFFORT) == solve(weights.copy(), [12] * 6, [3] * 6, effort=EFFORT)


def test_what_is_shared_is_built_once():
    graph = solve(np.array([[5, 5], [10, 10], [-5, -5]]), [8, 8])
    assert (graph.adders, negations(graph)) == (2, 1)
    assert solve(np.array([[0, 0], [4, 0]]), [8, 8], [9, 0]).adders == 0


@pytest.mark.parametrize(("lo", "hi", "width"), [(0, 0, 1), (-1, 0, 1), (0, 1, 2), (-128, 127, 8), (-129, 0, 9)])
def test_width_of_a_range(lo, hi, width):
    assert signed_width(lo, hi) == width


def test_weights_of_as_many_places_as_a_program_may_have_are_kept():
    weights = np.array([[(1 << 61) - 1, 3], [-(1 << 60) - 5, (1 << 61) + 1]], dtype=object)
    graph = solve(weights, [2, 2])
    assert (graph.matrix() == weights).all()


def plain(weights: np.ndarray) -> int:
    """Adders of canonical digits where nothing is shared."""
    return sum(max(0, sum(len(signed_digits(int(w))) for w in row) - 1) for row in weights)


@pytest.mark.parametrize("shape", [pytest.param((30, 20), marks=pytest.mark.nightly), (4, 60), (90, 4)])
def test_a_large_matrix_shares_pairs_and_mends_that(shape, monkeypatch):
    weights = np.random.default_rng(7).integers(-(1 << 11), 1 << 11, shape)
    weights[1] = weights[0]  # equal rows, and a row and a column of zeros
    weights[2], weights[:, 3] = 0, 0
    monkeypatch.setattr(search, "MANY", 1 << 13)
    adders._solved.cache_clear()
    quick, mended = solve(weights, [12] * shape[1], effort=0), solve(weights, [12] * shape[1], effort=EFFORT)
    for graph in (quick, mended):
        assert (graph.matrix() == weights).all()
    assert mended.adders < quick.adders < 0.7 * plain(weights)
    adders._solved.cache_clear()
    assert solve(weights, [12] * shape[1], effort=EFFORT) == mended


@pytest.mark.parametrize("shape", [(6, 40), (1, 60), (40, 3)])
def test_a_very_large_matrix_is_shared_in_blocks(shape, monkeypatch):
    weights = np.random.default_rng(8).integers(-(1 << 15), 1 << 15, shape)
    monkeypatch.setattr(search, "MANY", 0)
    monkeypatch.setattr(search, "DIFFERENT", 1 << 10)
    adders._solved.cache_clear()
    graph = solve(weights, [16] * shape[1], effort=0)
    assert (graph.matrix() == weights).all()
    assert graph.adders < 0.9 * plain(weights)
    adders._solved.cache_clear()


def test_weights_of_many_places_are_shared_too():
    weights = np.random.default_rng(9).integers(1 << 30, 1 << 40, (3, 3))
    graph = solve(weights, [16] * 3)
    assert (graph.matrix() == weights).all()
    assert graph.adders < 0.8 * plain(weights)


def test_a_wrong_search_is_noticed_and_not_used(monkeypatch):
    weights = np.array([[45, 77], [25, 13]])
    right = adders.best_sums

    def wrong(sums, columns, effort, rewrites):
        found = right(sums, columns, effort, rewrites)
        return [(d, [r[1:] for r in rows]) for d, rows in found] if effort else found

    monkeypatch.setattr(adders, "best_sums", wrong)
    adders._solved.cache_clear()
    assert (solve(weights, [8, 8]).matrix() == weights).all()
    adders._solved.cache_clear()


@given(st.lists(st.tuples(st.integers(1, 1 << 20), st.integers(-9, 9)), min_size=2, max_size=12))
def test_parts_pair_alike_in_numbers_of_either_kind(parts):
    sizes, shifts = [s for s, _ in parts], [f for _, f in parts]
    pairs, over = paired(sizes, shifts)
    assert sorted([i for pair in pairs for i in pair] + over) == list(range(len(parts)))
    assert len(over) == len(parts) % 2
    assert pairs == _plain(sizes, [f - min(shifts) for f in shifts])


def test_many_parts_are_paired_in_groups_of_like_size():
    sizes = np.random.default_rng(10).integers(1, 1 << 30, 2 * AT_ONCE + 77).tolist()
    pairs, over = paired(sizes, [0] * len(sizes))
    assert sorted([i for pair in pairs for i in pair] + over) == list(range(len(sizes)))
    assert len(over) == len(sizes) % 2
