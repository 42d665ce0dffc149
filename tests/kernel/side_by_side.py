"""The simple observers scan by scan, through the reference and through the batch, with their states compared."""

import dataclasses
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.result import Result

SPECIAL = [0.0, -0.0, 1e-300, 1e-45, -1.0, 1e30, 1e300, np.nan, np.inf, -np.inf]
positions = st.one_of(st.floats(-1e4, 1e4), st.sampled_from(SPECIAL))
steps = st.one_of(st.just(0.05), st.floats(1e-4, 2.0), st.sampled_from(SPECIAL))
enables = st.sampled_from([True, True, True, True, False])
stepped = st.sampled_from([True, True, True, True, False])


@dataclasses.dataclass(frozen=True)
class Axis:
    """One row: its inputs scan by scan, and whether each scan steps it. The tuning is that of the first scan."""

    inputs: Sequence[Any]
    rows: Sequence[bool]


def axes_of(inputs: Callable[[], st.SearchStrategy[Any]], most: int = 15) -> st.SearchStrategy[list[Axis]]:
    """Up to four rows of up to `most` scans; `inputs` draws one row's tuning and then its scans."""

    @st.composite
    def axis(draw: st.DrawFn, scans: int) -> Axis:
        one = draw(inputs())
        given = [
            dataclasses.replace(one, EnableIn=draw(enables), x=draw(positions), dt=draw(steps)) for _ in range(scans)
        ]
        return Axis(given, [draw(stepped) for _ in range(scans)])

    return st.integers(1, most).flatmap(lambda scans: st.lists(axis(scans), min_size=1, max_size=4))


def assert_batch_equals_reference(
    axes: Sequence[Axis],
    reference: Callable[[Any, Any], tuple[Any, Result]],
    initial: Callable[[], Any],
    module: ModuleType,
    state: Any,
    tuning: Any,
) -> None:
    """Every number and every result of every row after every scan, `==`; NaN equals NaN."""
    states = [initial() for _ in axes]
    for k in range(len(axes[0].inputs)):
        given = [axis.inputs[k] for axis in axes]
        rows = np.array([axis.rows[k] for axis in axes])
        codes = module.step(
            state,
            tuning,
            EnableIn=np.array([one.EnableIn for one in given]),
            x=np.array([one.x for one in given]),
            dt=np.array([one.dt for one in given]),
            rows=rows,
        )
        for row, one in enumerate(given):
            result = Result.SKIPPED
            if rows[row]:
                states[row], result = reference(states[row], one)
            assert Result(codes[row]) == result, (k, row)
            for field in dataclasses.fields(states[row]):
                expected, got = getattr(states[row], field.name), getattr(state, field.name)[..., row]
                if isinstance(expected, tuple):  # a ring, which is empty before the start
                    got = got[: len(expected)]
                np.testing.assert_array_equal(got, expected, err_msg=f"scan {k}, row {row}, {field.name}")


def run(
    reference: Callable[[Any, Any], tuple[Any, Result]], state: Any, inputs: Sequence[Any], *names: str
) -> NDArray[np.float64]:
    """These variables of the state after each scan, float64[scans, names]."""
    rows = []
    for one in inputs:
        state, _ = reference(state, one)
        rows.append([getattr(state, name) for name in names])
    return np.array(rows, np.float64)
