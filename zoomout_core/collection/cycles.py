# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps that agree: choose the candidate of each pair that closes cycles, so that a flip is outvoted.

Around three shapes, the maps of a collection should return to their start. Each pair has several candidates, such as
the map with left and right exchanged. They are chosen together, so that they are likely by themselves and close their
cycles. If no candidate of a pair does, the map through a third shape becomes one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.collection.pair_map import CandidateMaps, PairName
from zoomout_core.collection.shapes import ShapeSummary
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class CycleTuning(Tuning, set_by="collection"):
    """How candidates are chosen.

    Attributes:
        open: mean error of a cycle at which its cost saturates.
        closed: mean error of correct maps, which comes from the spacing of the samples.
        weight: weight of an open cycle relative to the logarithm of a candidate's probability.
        min_certainty: minimum probability of a candidate, so that even the most certain one can be outvoted.
        turned_inside_out: factor on the probability of a candidate that treats the orientation unlike the first.
        composed: probability of a map through a third shape.
        gain: minimum cost reduction of a change, so that ties change nothing.
        cycles: maximum number of cycles per pair; the most certain are kept.
        rounds: maximum number of passes over all pairs.
    """

    open: float = tuned(0.15, "at unit area", 1e-3, 10)
    closed: float = tuned(0.06, "at unit area", 0, 1)
    weight: float = tuned(6.0, "1", 0, 1000)
    min_certainty: float = tuned(0.01, "probability", 1e-9, 0.5)
    turned_inside_out: float = tuned(0.001, "1", 0, 1)
    composed: float = tuned(0.02, "probability", 1e-9, 1)
    gain: float = tuned(0.5, "1", 0, 100)
    cycles: int = tuned(12, "cycles", 1, 1000)
    rounds: int = tuned(20, "rounds", 1, 1000)


CYCLES = CycleTuning()

Triangle = tuple[PairName, PairName, PairName]


@dataclass(frozen=True, eq=False)
class Agreement:
    """The candidates of a collection's pairs that agree best.

    Attributes:
        candidate: number of each pair's candidate; one past the pair's own means a map through a third shape.
        through: that third shape, for pairs mapped through one.
        maps: the candidates of each pair, including those through third shapes.
        before: mean cycle error of each pair at unit area, with the most likely candidates; only for pairs in a cycle.
        after: the same with the chosen candidates.
        certainty: probability of each pair's candidate, given its cycles.
    """

    candidate: dict[PairName, int]
    through: dict[PairName, str]
    maps: dict[PairName, CandidateMaps]
    before: dict[PairName, float]
    after: dict[PairName, float]
    certainty: dict[PairName, float]

    @property
    def changed(self) -> list[PairName]:
        """Pairs whose candidate is not the most likely one by itself."""
        return [pair for pair, number in self.candidate.items() if number]


def choose_agreeing(maps: Mapping[PairName, CandidateMaps], shape: Callable[[str], ShapeSummary]) -> Agreement:
    """Choose a candidate for each pair of a collection, so that as many cycles as possible close.

    The maps have the most likely candidate first; `shape` returns the summary of the shape with a name.
    """
    votes = _Votes(dict(maps), shape)
    first = dict.fromkeys(maps, 0)
    before = {pair: votes.error(pair, first) for pair in maps if votes.cycles_of[pair]}
    labels = votes.improve(first)
    through = votes.compose(labels)
    labels = votes.settle(labels)
    return Agreement(
        labels,
        {pair: third for pair, third in through.items() if labels[pair] == len(maps[pair].certainty)},
        votes.maps,
        before,
        {pair: votes.error(pair, labels) for pair in before},
        {pair: votes.certainty(pair, labels) for pair in maps},
    )


@dataclass(eq=False)
class _Votes:
    """The cycles of some pairs, and the costs of choosing their candidates."""

    maps: dict[PairName, CandidateMaps]
    shape: Callable[[str], ShapeSummary]
    cycles_of: dict[PairName, list[Triangle]] = field(init=False)
    _known: dict[tuple[Triangle, tuple[int, int, int]], float] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        surest = {pair: float(each.certainty[0]) for pair, each in self.maps.items()}
        self.cycles_of = {
            pair: sorted(cycles, key=lambda cycle: -sum(surest[each] for each in cycle))[: CYCLES.cycles]
            for pair, cycles in _triangles(self.maps).items()
        }

    def error_around(self, cycle: Triangle, labels: Mapping[PairName, int]) -> float:
        """Mean distance, at unit area, between the start and end of a cycle, from each of its corners."""
        chosen = labels[cycle[0]], labels[cycle[1]], labels[cycle[2]]
        if (cycle, chosen) not in self._known:
            self._known[cycle, chosen] = self._measure(cycle, labels)
        return self._known[cycle, chosen]

    def _measure(self, cycle: Triangle, labels: Mapping[PairName, int]) -> float:
        a, b, c = _corners(cycle)
        errors = []
        for first, second, third in ((a, b, c), (b, c, a), (c, a, b)):
            corner = self.shape(first)
            place = np.arange(len(corner.samples))
            there = self._map(third, first, labels)[self._map(second, third, labels)[self._map(first, second, labels)]]
            errors.append(float(corner.distance(place, there).mean()))
        return float(np.mean(errors))

    def _map(self, start: str, end: str, labels: Mapping[PairName, int]) -> Integers:
        """(s,) the sample of one shape for each sample of the other."""
        pair = PairName(end, start)
        if pair in self.maps:
            return np.asarray(self.maps[pair].forward[labels[pair]])
        pair = PairName(start, end)
        return np.asarray(self.maps[pair].backward[labels[pair]])

    def error(self, pair: PairName, labels: Mapping[PairName, int]) -> float:
        """Mean error of the cycles that a pair is part of."""
        return float(np.mean([self.error_around(cycle, labels) for cycle in self.cycles_of[pair]]))

    def _openness(self, cycle: Triangle, labels: Mapping[PairName, int]) -> float:
        return CYCLES.weight * min(1.0, self.error_around(cycle, labels) / CYCLES.open)

    def prior(self, pair: PairName) -> Floats:
        """(m,) probability of the candidates of a pair by themselves."""
        maps = self.maps[pair]
        unlike = maps.reverses_orientation != maps.reverses_orientation[0]
        certainty = np.maximum(maps.certainty, CYCLES.min_certainty)
        return np.where(unlike, CYCLES.turned_inside_out * certainty, certainty)

    def certainty(self, pair: PairName, labels: Mapping[PairName, int]) -> float:
        """Probability of a pair's candidate among its candidates, with all other pairs fixed."""
        if not self.cycles_of[pair]:
            return float(self.maps[pair].certainty[labels[pair]])
        costs = self._costs(pair, dict(labels), self.cycles_of[pair])
        odds = np.exp(costs.min() - costs)
        return float(odds[labels[pair]] / odds.sum())

    def improve(self, labels: Mapping[PairName, int]) -> dict[PairName, int]:
        """Improve the chosen candidates until no single change lowers the cost."""
        found = dict(labels)
        for _ in range(CYCLES.rounds):
            if not sum([self._improve(pair, found) for pair in self.maps]):
                break
        return found

    def settle(self, labels: Mapping[PairName, int]) -> dict[PairName, int]:
        """Improve the chosen candidates until no change of one pair, or of all pairs of a shape, lowers the cost."""
        found = dict(labels)
        of_shape: dict[str, list[PairName]] = {}
        for pair in self.maps:
            for name in pair:
                of_shape.setdefault(name, []).append(pair)
        for _ in range(CYCLES.rounds):
            found = self.improve(found)
            if not sum([self._turn(pairs, found) for pairs in of_shape.values()]):
                break
        return found

    def _improve(self, pair: PairName, labels: dict[PairName, int]) -> bool:
        """Choose the cheapest candidate of a pair; returns whether it changed."""
        if not self.cycles_of[pair]:
            return False
        costs = self._costs(pair, labels, self.cycles_of[pair])
        best = int(np.argmin(costs))
        if costs[best] >= costs[labels[pair]] - CYCLES.gain:
            return False
        labels[pair] = best
        return True

    def _costs(self, pair: PairName, labels: dict[PairName, int], cycles: Sequence[Triangle]) -> Floats:
        """(m,) cost of each candidate of a pair, by itself and in some cycles, with all other pairs fixed."""
        now, costs = labels[pair], []
        for number, probability in enumerate(self.prior(pair)):
            labels[pair] = number
            costs.append(sum(self._openness(cycle, labels) for cycle in cycles) - np.log(probability))
        labels[pair] = now
        return np.array(costs)

    def _turn(self, pairs: list[PairName], labels: dict[PairName, int]) -> bool:
        """Change the candidates of all pairs of a shape together, such as a flipped one, if that costs less."""
        pairs = [pair for pair in pairs if self.cycles_of[pair]]
        stand = {pair: labels[pair] for pair in pairs}
        now = self._total(pairs, labels)
        # Lower bound of the cost: all cycles close and each pair has its most likely candidate.
        if now - sum(-np.log(self.prior(pair).max()) for pair in pairs) <= CYCLES.gain:
            return False
        for first in pairs:
            for number in range(len(self.prior(first))):
                if number == stand[first]:
                    continue
                labels[first] = number
                for other in pairs:
                    if other != first:
                        labels[other] = self._beside(first, other, labels)
                if self._total(pairs, labels) < now - CYCLES.gain:
                    return True
                labels.update(stand)
        return False

    def _beside(self, first: PairName, other: PairName, labels: dict[PairName, int]) -> int:
        """The candidate of a pair that agrees best with another pair of the same shape, ignoring all other pairs."""
        shared = [cycle for cycle in self.cycles_of[other] if first in cycle]
        return int(np.argmin(self._costs(other, labels, shared))) if shared else labels[other]

    def _total(self, pairs: list[PairName], labels: Mapping[PairName, int]) -> float:
        """The total cost of the candidates of some pairs."""
        cycles = {cycle for pair in pairs for cycle in self.cycles_of[pair]}
        own = sum(-np.log(self.prior(pair)[labels[pair]]) for pair in pairs)
        return float(own + sum(self._openness(cycle, labels) for cycle in cycles))

    def compose(self, labels: Mapping[PairName, int]) -> dict[PairName, str]:
        """Add a map through a third shape to the candidates of pairs whose cycles stay open; returns these shapes."""
        through = {}
        for pair, cycles in self.cycles_of.items():
            if not cycles or self.error(pair, labels) < CYCLES.open / 2:
                continue
            third = min((_third(pair, cycle) for cycle in cycles), key=lambda name: self._doubt(pair, name, labels))
            forward = self._map(third, pair.source, labels)[self._map(pair.target, third, labels)]
            backward = self._map(third, pair.target, labels)[self._map(pair.source, third, labels)]
            self.maps[pair], through[pair] = self.maps[pair].with_another(forward, backward, CYCLES.composed), third
        return through

    def _doubt(self, pair: PairName, third: str, labels: Mapping[PairName, int]) -> float:
        """How uncertain the maps between a pair and a third shape are."""
        legs = [leg for end in pair for leg in (PairName(third, end), PairName(end, third)) if leg in self.maps]
        others = [[cycle for cycle in self.cycles_of[leg] if pair not in cycle] for leg in legs]
        open_ones = sum(
            float(np.mean([self.error_around(cycle, labels) for cycle in cycles])) if cycles else CYCLES.open
            for cycles in others
        )
        return open_ones - sum(float(np.log(self.prior(leg)[labels[leg]])) for leg in legs) / 10


def pairs_in_cycles(pairs: Sequence[PairName]) -> list[PairName]:
    """The pairs that are part of a cycle of three."""
    return [pair for pair, cycles in _triangles(pairs).items() if cycles]


def _triangles(pairs: Iterable[PairName]) -> dict[PairName, list[Triangle]]:
    """The cycles of three that each pair is part of."""
    found: dict[PairName, list[Triangle]] = {pair: [] for pair in pairs}
    beside: dict[str, dict[str, PairName]] = {}
    for pair in found:
        beside.setdefault(pair.source, {})[pair.target] = pair
        beside.setdefault(pair.target, {})[pair.source] = pair
    for pair in found:
        first, second = sorted(pair)
        # Each triangle once, from the pair of its first two corners.
        for third in beside[first].keys() & beside[second].keys():
            if third > second:
                for each in (cycle := (pair, beside[second][third], beside[first][third])):
                    found[each].append(cycle)
    return {pair: sorted(cycles) for pair, cycles in found.items()}


def _corners(cycle: Triangle) -> tuple[str, str, str]:
    """The three shapes of a cycle of pairs (first and second, second and third, first and third)."""
    first, second, third = cycle
    (a,) = set(first) & set(third)
    (b,) = set(first) & set(second)
    (c,) = set(second) & set(third)
    return a, b, c


def _third(pair: PairName, cycle: Triangle) -> str:
    """The shape of a cycle that is not in the pair."""
    (name,) = {name for other in cycle for name in other} - set(pair)
    return name
