"""Metrics for Prometheus: families with their samples."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

Value = float | Mapping[Any, float]


def gauge(name: str, text: str, value: Value, *labels: str) -> Metric:
    return _filled(GaugeMetricFamily(f"clutchdiag_{name}", text, labels=labels), value)


def counter(name: str, text: str, value: Value, *labels: str) -> Metric:
    return _filled(CounterMetricFamily(f"clutchdiag_{name}", text, labels=labels), value)


def histogram(
    name: str,
    text: str,
    bounds: Sequence[float],
    values: Mapping[Any, tuple[Sequence[int], float]],  # by tuples of labels
    *labels: str,
) -> Metric:
    """Return a family of counts between bounds, one more than these, and the sum of what was counted."""
    family = HistogramMetricFamily(f"clutchdiag_{name}", text, labels=labels)
    for key, (counts, total) in values.items():
        edges = [*(f"{bound:.1f}" for bound in bounds), "+Inf"]
        family.add_metric(key, list(zip(edges, accumulate(counts), strict=True)), total)
    return family


def _filled(family: GaugeMetricFamily | CounterMetricFamily, value: Value) -> Metric:
    """Return a family with its value, or with one value for each of its labels."""
    values = value if isinstance(value, Mapping) else {(): value}
    for key, number in values.items():
        labels: Sequence[str] = key if isinstance(key, tuple) else (str(key),)
        family.add_metric(labels, number)
    return family


class Told(Collector):
    """A collector that calls ``tell`` at each scrape."""

    def __init__(self, tell: Callable[[], Iterable[Metric]]) -> None:
        self._tell = tell

    def collect(self) -> Iterable[Metric]:
        return self._tell()
