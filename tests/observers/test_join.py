"""Observers joined: every tag of every axis goes on, to the last bit, as if they had not been."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softplc.observers.axes import AxisPlace, AxisSpec
from softplc.observers.join import Part, UnlikeError, join
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.observer import AxisObserver
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Sample, StatusCode
from softplc.tags import Image
from softplc.timing import Scan
from tests.observers.rig import UTC, make_rig
from tests.soak.run import OBSERVERS, POLICIES

PARTS = ([0, 3], [4], [1, 2, 5])
N, JOINED_AT, PERIOD = 6, 90, 0.05
SIGNALS = (
    None,
    SignalSpec(modulo=360.0, quantum=0.1),
    SignalSpec(counter=655.36, max_rate=1e5),
    SignalSpec(counter=655.36, modulo=360.0, dead_band=0.1),
    SignalSpec(quantum=0.5),
    None,
)
SPECS = tuple(
    replace(spec, name=f"A{axis}", enable_writable=True, tuning_writable=True, dead_time=0.01)
    for axis, spec in enumerate(POLICIES)
)
Build = Callable[[list[int]], AxisObserver]


def building(specs: Sequence[AxisSpec], configs: Sequence[Any]) -> tuple[Build, Image, Image]:
    """How observers of some of these axes are built, the inputs and the outputs of all."""
    shadows = bool(specs[0].shadow)
    rig = make_rig(*zip(specs, configs, strict=True), shadow_tags=shadows)
    blocks = [block for block in rig.table.blocks if block.kind == "axis"]
    own = [tuple(N + 3 * axis + part for part in range(3)) if shadows else () for axis in range(N)]
    places = [AxisPlace(specs[axis], axis, None, blocks[axis], None, *own[axis]) for axis in range(N)]

    def build(axes: list[int]) -> AxisObserver:
        observer = type(configs[0]).build([places[axis] for axis in axes], [configs[axis] for axis in axes])
        assert isinstance(observer, AxisObserver)
        return observer

    return build, rig.inputs, rig.outputs


def sample(inputs: Image, random: np.random.Generator, number: int, now: float) -> None:
    """New samples, some of them faulty, and what a PLC makes of them."""
    for index in range(len(inputs)):
        value, status = (300.0 + 7.0 * number + index) % 655.36 if index < N else 5.0 * number, int(StatusCode.GOOD)
        if random.random() < 0.05:
            value = float(random.choice([np.nan, np.inf, 1e9, 0.0]))
        if random.random() < 0.05:
            status = int(random.choice([0x80310000, 0x808C0000, 0x40900000, 0x40000000]))
        if random.random() < 0.9:
            inputs.put(index, Sample(value, status, UTC + round(now * 1e9)), now)


def command(observers: Sequence[AxisObserver], random: np.random.Generator, outputs: Image) -> None:
    index, value = int(random.integers(len(outputs))), float(random.choice([0.0, 1.0, 0.5, 2.0]))
    for observer in observers:
        observer.command(index, value)


def assert_goes_on(specs: Sequence[AxisSpec], configs: Sequence[Any], scans: int = 240) -> None:
    build, inputs, outputs = building(specs, configs)
    parts = [(axes, build(axes)) for axes in PARTS]
    joined, joined_outputs = build(list(range(N))), outputs
    random, now = np.random.default_rng(5), 100.0
    for number in range(scans):
        now += float(random.choice([PERIOD, 0.051, 0.0, 1.0], p=[0.9, 0.08, 0.01, 0.01]))
        scan = Scan(number, now, UTC + round(now * 1e9), PERIOD, PERIOD, 0)
        sample(inputs, random, number, now)
        together = [joined] if number > JOINED_AT else []
        if random.random() < 0.3:
            command([*(observer for _, observer in parts), *together], random, outputs)
        for _, observer in parts:
            observer.step(scan, inputs, outputs)
        if number == JOINED_AT:
            join(joined, [Part(observer, build(axes), np.array(axes)) for axes, observer in parts])
            joined_outputs = Image(len(outputs))
            joined_outputs.take_over(outputs)
        for observer in together:
            observer.step(scan, inputs, joined_outputs)
            for field in ("values", "statuses", "source_timestamps"):
                np.testing.assert_array_equal(getattr(joined_outputs, field), getattr(outputs, field), f"{number}")


@pytest.mark.parametrize("name", OBSERVERS)
def test_axes_of_joined_observers_go_on_as_if_nothing_had_happened(name: str):
    config = OBSERVERS[name][0]
    judged = {"consistency": (40, 5)} if {"Innovation", "S"} <= set(config.estimates) else {}
    assert_goes_on([replace(spec, **judged) for spec in SPECS], [config] * N)


@pytest.mark.parametrize("name", ["aoi", "adaptive", "moving_average"])
def test_counters_turns_and_shadows_go_on_where_they_are(name: str):
    specs = [
        replace(spec, signal=signal, shadow=("position", "velocity"), range=None)
        for spec, signal in zip(SPECS, SIGNALS, strict=True)
    ]
    assert_goes_on(specs, [OBSERVERS[name][0]] * N)


def test_windows_of_different_length_go_on():
    assert_goes_on(SPECS, [MovingAverageConfig(type="moving_average", window=3 + axis) for axis in range(N)])


def test_what_does_not_fit_is_not_joined_and_the_observers_stay_as_they_were():
    build, inputs, outputs = building(SPECS, [MovingAverageConfig(type="moving_average", window=4)] * N)
    parts = [(axes, build(axes)) for axes in PARTS]
    takes = parts[0][1].command
    assert any(takes(tag, 9.0) and not takes(tag, 2.5) for tag in range(len(outputs)))  # a longer window
    random = np.random.default_rng(5)
    for number in range(20):
        sample(inputs, random, number, 0.05 * number)
        for _, observer in parts:
            observer.step(Scan(number, 0.05 * number, UTC, PERIOD, PERIOD, 0), inputs, outputs)
    before = [vars(observer._kernel._state)["X"].copy() for _, observer in parts]
    with pytest.raises(UnlikeError, match="MovingAverageBatchState"):
        join(build(list(range(N))), [Part(observer, build(axes), np.array(axes)) for axes, observer in parts])
    for (_, observer), rings in zip(parts, before, strict=True):
        np.testing.assert_array_equal(vars(observer._kernel._state)["X"], rings)
