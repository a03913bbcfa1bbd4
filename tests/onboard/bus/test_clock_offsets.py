"""Offsets of clocks: true bounds whatever delays, drift and losses are."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.bus.clock_offsets import DRIFT, Clocks
from onboard.bus.codec import decode, encode
from onboard.bus.schema import ClockMessage, HeardClock

_MS = 1_000_000
_S = 1_000_000_000
_A = 11
_B = 22


class _World:
    """Two hosts whose clocks are apart and drift; messages with delays of their own on each way,
    some lost.

    ``true_ns`` runs with A's clock; B's is ``offset_ns`` ahead and ``drift`` faster.
    """

    def __init__(
        self, offset_ns: int, drift: float, there_s, back_s, *, loss: float = 0.0, seed: int = 0
    ) -> None:
        self.a = Clocks("a", _A)
        self.b = Clocks("b", _B)
        self.offset_ns = offset_ns
        self.drift = drift
        self._there_s = there_s
        self._back_s = back_s
        self.loss = loss
        self._random = random.Random(seed)
        self.now_ns = 1000 * _S
        self._on_the_way: list[tuple[int, Clocks, ClockMessage]] = []

    def b_ns(self, true_ns: int) -> int:
        return true_ns + self.offset_ns + int(self.drift * (true_ns - 1000 * _S))

    def run(self, seconds: float, check=None) -> None:
        for step in range(int(seconds * 100)):
            self.now_ns += 10 * _MS
            if step % 50 == 0:
                self._send(self.a.message(self.now_ns), self.b, self._there_s())
            if step % 50 == 23:
                self._send(self.b.message(self.b_ns(self.now_ns)), self.a, self._back_s())
            for due in sorted(
                (row for row in self._on_the_way if row[0] <= self.now_ns), key=lambda row: row[0]
            ):
                self._on_the_way.remove(due)
                at_ns, whom, message = due
                whom.hear(message, at_ns if whom is self.a else self.b_ns(at_ns))
            if check is not None:
                check(self)

    def _send(self, message: ClockMessage, whom: Clocks, delay_s: float) -> None:
        if self._random.random() >= self.loss:
            self._on_the_way.append((self.now_ns + int(delay_s * 1e9), whom, message))

    @property
    def truth_s(self) -> float:
        return (self.b_ns(self.now_ns) - self.now_ns) * 1e-9


def _delays(seed: int, shortest_s: float, mean_s: float):
    source = random.Random(seed)
    return lambda: shortest_s + source.expovariate(1.0 / mean_s)


def measured(clocks: Clocks, node: str, now_ns: int) -> tuple[float, float]:
    """Return the offset of a node's clock that is known, and its bound [s]."""
    found = clocks.offset_s(node, now_ns)
    assert found is not None
    return found


def test_a_clock_an_hour_ahead_is_found_within_half_the_quickest_round_trip() -> None:
    world = _World(3600 * _S, 0.0, _delays(1, 0.002, 0.003), _delays(2, 0.002, 0.003))
    world.run(20.0)
    offset_s, bound_s = measured(world.a, "b", world.now_ns)
    assert offset_s == pytest.approx(3600.0, abs=bound_s)
    assert bound_s < 0.006
    back_s, _ = measured(world.b, "a", world.b_ns(world.now_ns))
    assert back_s == pytest.approx(-3600.0, abs=0.006)


@settings(max_examples=60, deadline=None)
@given(
    offset_s=st.floats(-1e5, 1e5),
    drift=st.floats(-0.9 * DRIFT, 0.9 * DRIFT),
    shortest_s=st.tuples(st.floats(0.0, 0.05), st.floats(0.0, 0.05)),
    mean_s=st.tuples(st.floats(0.0005, 0.05), st.floats(0.0005, 0.05)),
    loss=st.floats(0.0, 0.5),
    seed=st.integers(0, 1000),
)
def test_the_true_offset_lies_within_the_bound_however_unequal_the_two_ways_are(
    offset_s: float, drift: float, shortest_s: tuple, mean_s: tuple, loss: float, seed: int
) -> None:
    world = _World(
        int(offset_s * 1e9),
        drift,
        _delays(seed, shortest_s[0], mean_s[0]),
        _delays(seed + 1, shortest_s[1], mean_s[1]),
        loss=loss,
        seed=seed,
    )

    def check(world: _World) -> None:
        found = world.a.offset_s("b", world.now_ns)
        if found is not None:
            assert abs(found[0] - world.truth_s) <= found[1] + 1e-6

    world.run(30.0, check)
    assert world.a.restarts == world.b.restarts == 0
    # what follows for a sample: never younger than it is, and never from the future
    age_s = 0.05
    taken_ns = world.now_ns - 50 * _MS
    told_s = (world.now_ns - world.a.own_ns("b", world.b_ns(taken_ns), world.now_ns)) * 1e-9
    if world.a.is_measured("b"):
        assert told_s >= age_s - 1e-6
        assert told_s <= age_s + 2.0 * measured(world.a, "b", world.now_ns)[1] + 1e-6


def test_the_bound_grows_while_nothing_is_heard_and_stays_true() -> None:
    world = _World(-7 * _S, 0.5 * DRIFT, _delays(1, 0.001, 0.001), _delays(2, 0.001, 0.001))
    world.run(5.0)
    _, before_s = measured(world.a, "b", world.now_ns)
    world.loss = 1.0
    world.run(20.0)
    offset_s, bound_s = measured(world.a, "b", world.now_ns)
    assert bound_s == pytest.approx(before_s + 20.0 * DRIFT, rel=0.1)
    assert abs(offset_s - world.truth_s) <= bound_s


def test_nodes_of_one_host_share_their_clock_without_any_measurement() -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _A)
    a.hear(b.message(5 * _S), 5 * _S + 300 * _MS)
    assert a.is_measured("b")
    assert a.offset_s("b", 9 * _S) == (0.0, 0.0)
    # a message that was held up for two seconds is two seconds old, not new
    assert a.own_ns("b", 5 * _S, 7 * _S) == 5 * _S
    assert a.own_ns("b", 9 * _S, 7 * _S) == 7 * _S
    assert a.message(8 * _S).heard == ()


def test_an_unknown_node_is_judged_by_its_arrival_and_one_half_measured_too() -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _B)
    assert a.own_ns("b", 100, 200) == 100
    assert a.own_ns("b", 9 * _S, 5 * _S) == 5 * _S - 20 * _MS
    assert not a.is_measured("b")
    a.hear(b.message(9 * _S), 5 * _S)
    assert not a.is_measured("b")
    assert a.offset_s("b", 5 * _S) is None
    # their clock may by chance be near ours: it is another one all the same
    assert a.own_ns("b", 5 * _S - 10 * _MS, 5 * _S) == 5 * _S - 20 * _MS


def _exchange(a: Clocks, b: Clocks, a_ns: int, b_minus_a_ns: int) -> None:
    """One message each way, 1 ms each."""
    b.hear(a.message(a_ns), a_ns + b_minus_a_ns + _MS)
    a.hear(b.message(a_ns + b_minus_a_ns + 2 * _MS), a_ns + 3 * _MS)


def _beat(a: Clocks, b: Clocks, from_ns: int, b_minus_a_ns: int, count: int) -> int:
    """That many exchanges, two a second; the time after them."""
    for number in range(count):
        _exchange(a, b, from_ns + number * _S // 2, b_minus_a_ns)
    return from_ns + count * _S // 2


def test_a_host_that_has_rebooted_is_measured_anew_and_its_old_offset_forgotten() -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _B)
    now_ns = _beat(a, b, 10 * _S, 500 * _S, 4)
    assert measured(a, "b", now_ns)[0] == pytest.approx(500.0, abs=0.005)
    now_ns = _beat(a, Clocks("b", _B + 1), now_ns, -7 * _S, 5)
    assert a.restarts == 1
    assert measured(a, "b", now_ns)[0] == pytest.approx(-7.0, abs=0.005)


@pytest.mark.parametrize(
    "lie",
    [
        {"host": 77},
        {"host": _A},  # our own
        {"host": _A, "sent_ns": 12 * _S},
        {"sent_ns": 10**18},
        {"sent_ns": -(10**18)},
        {"heard": (HeardClock("a", _A, 5, -(10**18)),)},
        {"host": 77, "heard": (HeardClock("a", _A, 12 * _S - 5 * _MS, 700 * _S),)},
    ],
)
def test_a_false_message_in_the_name_of_a_node_that_lives_changes_nothing(lie: dict) -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _B)
    now_ns = _beat(a, b, 10 * _S, 500 * _S, 4)
    for _ in range(20):  # ten seconds long, as often as the true ones
        fields = {"node": "b", "host": _B, "sequence": 9, "sent_ns": now_ns + 500 * _S, **lie}
        a.hear(ClockMessage(**fields), now_ns)
        assert a.is_measured("b")
        assert a.own_ns("b", 500 * _S + now_ns - 20 * _MS, now_ns) == pytest.approx(
            now_ns - 20 * _MS, abs=5 * _MS
        )
        now_ns = _beat(a, b, now_ns, 500 * _S, 1)
    assert a.restarts == 0


def test_arrivals_of_our_messages_before_a_reboot_bound_nothing() -> None:
    b = Clocks("b", _B)
    b.hear(Clocks("a", _A).message(9000 * _S), 50 * _S)
    a = Clocks("a", _A + 1)
    a.hear(b.message(51 * _S), 1 * _S)
    assert not a.is_measured("b")


def test_a_clock_that_stood_still_is_noticed_and_measured_anew() -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _B)
    _exchange(a, b, 10 * _S, 500 * _S)
    now_ns = _beat(a, b, 40 * _S, 490 * _S, 6)  # the other host was suspended for ten seconds
    assert a.restarts >= 1
    assert measured(a, "b", now_ns)[0] == pytest.approx(490.0, abs=0.005)


def test_lies_are_survived() -> None:
    a = Clocks("a", _A)
    b = Clocks("b", _B)
    _exchange(a, b, 10 * _S, 500 * _S)
    a.hear(ClockMessage(node="b", host=_B, sequence=9, sent_ns=10**18, heard=()), 11 * _S)
    a.hear(
        ClockMessage(
            node="b", host=_B, sequence=9, sent_ns=-1, heard=(HeardClock("a", _A, 5, -(10**18)),)
        ),
        12 * _S,
    )
    for second in range(13, 16):
        _exchange(a, b, second * _S, 500 * _S)
    assert measured(a, "b", 16 * _S)[0] == pytest.approx(500.0, abs=0.005)


def test_unknown_nodes_cannot_fill_the_memory() -> None:
    a = Clocks("a", _A)
    for number in range(1000):
        a.hear(Clocks(f"x{number}", 1000 + number).message(5 * _S), 6 * _S)
    assert len(a.message(7 * _S).heard) <= 300
    assert not a.is_measured("x999")


def test_the_mocap_of_a_hundred_vehicles_on_one_computer_is_measured() -> None:
    a = Clocks("a", _A)
    for number in range(100):
        a.hear(Clocks(f"vehicle{number}", _A).message(5 * _S), 5 * _S)
    mocap = Clocks("mocap", _B)
    _exchange(a, mocap, 10 * _S, 500 * _S)
    assert a.is_measured("mocap")


def test_grounds_that_come_and_go_are_forgotten_in_favour_of_the_one_that_is_there() -> None:
    a = Clocks("a", _A)
    for number in range(300):
        ground = Clocks(f"ground-{number}", _A)
        a.hear(ground.message(number * 100 * _S), number * 100 * _S)
        assert a.offset_s(f"ground-{number}", number * 100 * _S) == (0.0, 0.0)


def test_a_clock_message_of_twenty_nodes_is_small_and_comes_back_the_same() -> None:
    a = Clocks("a", _A)
    for number in range(20):
        a.hear(Clocks(f"vehicle{number}", 2**48 - number).message(2**60), 2**60)
    message = a.message(2**60 + 1)
    data = encode(message)
    assert decode(data, ClockMessage) == message
    assert len(data) < 1000


def test_only_other_hosts_have_bounds_and_are_forgotten_when_they_are_gone() -> None:
    world = _World(80 * _S, 0.0, lambda: 0.002, lambda: 0.004)
    # of its own host
    world.b.hear(ClockMessage(node="c", host=_B, sequence=1, sent_ns=5, heard=()), 5)
    world.run(0.1)
    # heard, and not yet heard of
    assert world.b.largest_errors_s(world.b_ns(world.now_ns)) == {"a": float("inf")}
    world.run(3.0)
    assert world.a.largest_errors_s(world.now_ns)["b"] == pytest.approx(0.003, abs=0.002)
    assert world.a.largest_errors_s(world.now_ns + 120 * _S) == {}


def test_the_worlds_clocks_of_two_hosts_are_compared_whatever_their_monotonic_clocks_are() -> None:
    """B's monotonic clock is 5000 s ahead of ours, and its computer believes to be 2.5 s later."""
    world = _World(5000 * _S, 0.0, lambda: 0.002, lambda: 0.004)
    world_ns = 1_795_000_000 * _S
    a_offset_ns = world_ns - world.now_ns
    assert world.a.world_ahead_s("b", world.now_ns, a_offset_ns) is None
    world.run(3.0)
    assert world.a.world_ahead_s("b", world.now_ns, a_offset_ns) is None  # it tells none

    b_ns = world.b_ns(world.now_ns)
    told_ns = world.now_ns + a_offset_ns + 2_500 * _MS
    world.a.hear(world.b.message(b_ns, told_ns), world.now_ns + 2 * _MS)
    compared = world.a.world_ahead_s("b", world.now_ns, a_offset_ns)
    assert compared is not None
    ahead_s, error_s = compared
    assert ahead_s == pytest.approx(2.5, abs=0.004)
    assert abs(ahead_s - 2.5) <= error_s < 0.005


def test_a_process_of_our_own_host_has_our_time_of_the_world_unless_it_tells_another() -> None:
    a = Clocks("a", _A)
    c = Clocks("c", _A)
    offset_ns = 1_795_000_000 * _S
    a.hear(c.message(5 * _S, 5 * _S + offset_ns), 5 * _S + 1000)
    assert a.world_ahead_s("c", 6 * _S, offset_ns) == (0.0, 0.0)
    assert a.world_ahead_s("c", 6 * _S, offset_ns - _S) == (1.0, 0.0)
    a.hear(c.message(6 * _S), 6 * _S + 1000)
    assert a.world_ahead_s("c", 7 * _S, offset_ns) is None
