"""Seeded noise of a measurement, the same for a step however often and in whatever order it is asked for."""

import zlib
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from softplc.model import Model

_BLOCK = 1024  # steps that are drawn at once

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


class UniformNoise(Model):
    """Uniform between −half_width and +half_width; its variance is half_width² / 3."""

    type: Literal["uniform"]
    half_width: Annotated[float, Field(ge=0)] = 2.0
    """In the axis' unit."""

    def draw(self, random: np.random.Generator, count: int) -> NDArray[np.float64]:
        """`count` values, [count]."""
        return random.uniform(-self.half_width, self.half_width, count)


class GaussianNoise(Model):
    """Normally distributed with mean 0."""

    type: Literal["gaussian"]
    std: Annotated[float, Field(ge=0)]
    """Standard deviation, in the axis' unit."""

    def draw(self, random: np.random.Generator, count: int) -> NDArray[np.float64]:
        """`count` values, [count]."""
        return random.normal(0.0, self.std, count)


class NoNoise(Model):
    """A measurement that is the truth."""

    type: Literal["none"] = "none"

    def draw(self, random: np.random.Generator, count: int) -> NDArray[np.float64]:
        """`count` zeros, [count]."""
        return np.zeros(count)


Noise = Annotated[UniformNoise | GaussianNoise | NoNoise, Field(discriminator="type")]


class Stream:
    """Random values by step number: a function of seed, key and step alone.

    The key names what the stream is for, so an axis keeps its noise when others come or go.
    """

    def __init__(self, seed: int, key: str, draw: Draw) -> None:
        self._entropy = (seed, zlib.crc32(key.encode()))
        self._draw = draw
        self._number = -1
        self._block: NDArray[np.float64] = np.empty(0)

    def at(self, step: int) -> float:
        """The value of a step, counted from 0."""
        number, index = divmod(step, _BLOCK)
        if number != self._number:
            self._block = self._draw(np.random.default_rng((*self._entropy, number)), _BLOCK)
            self._number = number
        return float(self._block[index])
