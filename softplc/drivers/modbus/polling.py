"""What to ask of a device in each read, and how its answers become samples: no I/O, no clock.

A device that does not know one address of a request refuses the request as a whole. Such a request is split, and its
parts asked for, until what the device does give is in requests of its own; this search has its share of the time of
each read and goes on in the next. A value that is refused alone is *parked*: it stays Bad with the device's own
reason, and of all parked values one is asked again in each read. So a wrong address neither takes the right ones
with it nor costs a request each time. When a parked value is given after all, everything is planned anew.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softplc.drivers.modbus.codec import Decoder, Field
from softplc.drivers.modbus.pdu import ILLEGAL_ADDRESS, ILLEGAL_VALUE, Refused, read_request
from softplc.drivers.modbus.plan import Limits, Request, Span, plan, split
from softplc.sample import StatusCode
from softplc.tags import Image


@dataclass(frozen=True, slots=True)
class Value:
    """One reading: where it lies in the device, and what its bytes mean (`field.byte` and `.bit` are not used)."""

    span: Span
    field: Field


@dataclass(frozen=True, slots=True)
class Question:
    """A request and its PDU, encoded once."""

    request: Request
    pdu: bytes


@dataclass(frozen=True, slots=True)
class Answer:
    """What the device said: data bytes or a refusal; when it arrived, in monotonic seconds and in ns UTC."""

    question: Question
    reply: bytes | Refused
    arrival: float
    timestamp: int

    @property
    def unknown_address(self) -> bool:
        """The device does not know the range, or gives no range so long."""
        return isinstance(self.reply, Refused) and self.reply.code in (ILLEGAL_ADDRESS, ILLEGAL_VALUE)


class PollState:
    """The questions of one connection. Raises ValueError where `plan` does."""

    def __init__(self, values: Sequence[Value], limits: Limits) -> None:
        self._values, self._limits = values, limits
        self._live = _questions(plan((value.span for value in values), limits))
        self._parts: deque[Answer] = deque()
        self._parked: dict[Span, Answer] = {}
        self._turn = 0
        self._layout = _Layout(values, [])

    @property
    def live(self) -> list[Question]:
        """What every read asks."""
        return self._live

    @property
    def settled(self) -> bool:
        """A read asks what is live and nothing else: no value is refused or searched for."""
        return not self._parts and not self._parked

    def fill(
        self, wire: NDArray[np.uint8], arrivals: NDArray[np.float64], stamps: NDArray[np.int64], into: Image
    ) -> None:
        """Fill `into` when settled from the data of all live questions, one after the other; arrivals [questions]."""
        if self._layout.questions != self._live:
            self._layout = _Layout(self._values, self._live)
        self._layout.fill_good(wire, arrivals, stamps, into)

    @property
    def refused(self) -> dict[Span, Refused]:
        """The values that the device refuses alone, and how it did last."""
        replies = ((span, answer.reply) for span, answer in self._parked.items())
        return {span: reply for span, reply in replies if isinstance(reply, Refused)}

    def start(self) -> "Round":
        """What one read asks; a round that is not finished leaves no trace."""
        self._turn += 1
        return Round(self._live, self._parts, self._parked, self._turn, self._limits)

    def finish(self, done: "Round", into: Image) -> None:
        """Fill `into`, one entry for each value, from the answers of a round in which all that was due was asked."""
        known = [*done.given, *done.parts, *done.parked.values()]
        questions = [answer.question for answer in known]
        if questions != self._layout.questions:
            self._layout = _Layout(self._values, questions)
        self._layout.fill(into, known)
        self._live, self._parts, self._parked = [answer.question for answer in done.given], done.parts, done.parked
        if done.recovered:
            self._live = _questions(plan((span for q in self._live for span in q.request.spans), self._limits))


class Round:
    """One read: what was answered in it, and what is left of the search for what the device does not know.

    `given` are the answers to ask for again, `parts` those still to be asked, with the answer to the whole as yet,
    `parked` the refused values; `recovered` when one of them was given.
    """

    def __init__(
        self, live: list[Question], parts: deque[Answer], parked: dict[Span, Answer], turn: int, limits: Limits
    ) -> None:
        self.given: list[Answer] = []
        self.parts, self.parked = parts.copy(), parked.copy()
        self.recovered = False
        self._live, self._turn, self._limits = live, turn, limits

    def due(self, time_left: Callable[[], bool], live: bool = True) -> Iterator[Question]:
        """One question after the other; each answer is to be taken before the next.

        All that the device gives (`live`, unless those are taken already), parts of what it refused while there is
        time, at least one, and a parked value.
        """
        parked = list(self.parked.values())
        if live:
            yield from self._live
        if self.parts:
            yield self.parts.popleft().question
        while self.parts and time_left():
            yield self.parts.popleft().question
        if parked:
            yield parked[self._turn % len(parked)].question

    def take(self, answer: Answer) -> None:
        """Keep an answer, or put the parts of its question in its place."""
        request = answer.question.request
        if answer.unknown_address and len(request.spans) > 1:
            parts = _questions(split(request, self._limits))
            self.parts.extend(replace(answer, question=part) for part in parts)
        elif answer.unknown_address or (request.spans[0] in self.parked and isinstance(answer.reply, Refused)):
            self.parked[request.spans[0]] = answer
        else:
            self.given.append(answer)
            self.recovered |= self.parked.pop(request.spans[0], None) is not None


class _Layout:
    """Where each value is found when the data of all questions lie one after the other."""

    def __init__(self, values: Sequence[Value], questions: list[Question]) -> None:
        self.questions = questions
        fields: dict[Span, tuple[int, int, int | None]] = {}
        base = 0
        for number, q in enumerate(questions):
            for span in q.request.spans:
                steps = span.start - q.request.start
                byte, bit = (steps // 8, steps % 8) if span.table.bits else (2 * steps, None)
                fields[span] = (number, base + byte, bit)
            base += q.request.size
        placed = [(value.field, *fields[value.span]) for value in values] if questions else []
        self._question_of: NDArray[np.intp] = np.array([number for _, number, _, _ in placed], np.intp)
        self._decoder = Decoder([replace(field, byte=byte, bit=bit) for field, _, byte, bit in placed])

    def fill(self, into: Image, answers: Sequence[Answer]) -> None:
        """Samples of all values from one answer to each question, in the order of the questions."""
        if not answers:
            return
        wire = b"".join(a.reply if isinstance(a.reply, bytes) else bytes(a.question.request.size) for a in answers)
        arrivals, stamps = np.array([a.arrival for a in answers]), np.array([a.timestamp for a in answers], np.int64)
        self.fill_good(np.frombuffer(wire, np.uint8), arrivals, stamps, into)
        statuses = [a.reply.status if isinstance(a.reply, Refused) else int(StatusCode.GOOD) for a in answers]
        if any(statuses):
            into.statuses[:] = np.array(statuses, np.uint32).take(self._question_of)
            into.values[into.statuses >= StatusCode.BAD] = np.nan

    def fill_good(
        self, wire: NDArray[np.uint8], arrivals: NDArray[np.float64], stamps: NDArray[np.int64], into: Image
    ) -> None:
        """Samples of all values from the data of all questions, one after the other; arrivals and stamps of each."""
        into.values[:] = self._decoder.decode(wire)
        into.arrivals[:] = arrivals.take(self._question_of)
        into.source_timestamps[:] = stamps.take(self._question_of)
        into.statuses[:] = StatusCode.GOOD


def _questions(requests: Sequence[Request]) -> list[Question]:
    return [Question(request, read_request(request)) for request in requests]
