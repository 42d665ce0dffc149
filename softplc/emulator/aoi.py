"""The PLC program of the emulated axis: the AOI runs in each step, as a PLC that already has it would run it.

It is the scalar reference of the kernel, statement by statement the Structured Text; softplc itself runs the batch.
"""

from dataclasses import replace

import numpy as np

from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import PlantStep
from softplc.emulator.program import AoiOutputs, AoiProgram
from softplc.emulator.scenario import Scenario
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real


class AoiPrograms:
    """Runs the AOI of each axis that has one, once for each step that is shown."""

    def __init__(self, scenario: Scenario, memory: MemoryState) -> None:
        self._programs = [axis.aoi for axis in scenario.axes]
        self._states = [AoiState() for _ in scenario.axes]
        self._period_ms = scenario.period_ms
        self._memory = memory
        self._last: int | None = None

    def run(self, step: PlantStep) -> PlantStep:
        """The step with the outputs in it. A step that was skipped makes the next dt longer, as in a PLC."""
        passed = 1 if self._last is None else step.number - self._last
        self._last = step.number
        dt = passed * self._period_ms
        axes = list(step.axes)
        for index, program in enumerate(self._programs):
            if program is not None:
                axes[index] = replace(axes[index], aoi=self._scan(index, program, axes[index].position, dt))
        return replace(step, axes=tuple(axes))

    @np.errstate(all="ignore")
    def _scan(self, index: int, program: AoiProgram, x: float, dt: float) -> AoiOutputs:
        enable_in = self._memory.enable[index]
        run = aoi_real if program.precision == "real" else aoi_lreal
        inputs = AoiInputs(enable_in, x, dt, program.q_x, program.q_x_dot, program.r_x)
        state, _ = run(self._states[index], inputs)
        self._states[index] = state
        return AoiOutputs(enable_in, dt, float(state.y), float(state.y_dot))
