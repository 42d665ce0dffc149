"""What to ask of a device in each read, and how its answers become samples: no I/O, no clock.

A device that does not know one address of a request refuses the request as a whole. Such a request is split until
what the device does give is in requests of its own; a value that it refuses alone is *parked*: it stays Bad with the
device's own reason, and of all parked values one is asked again in each read. So a wrong address neither takes the
right ones with it nor costs a request each time. When a parked value is given after all, everything is planned anew.
"""

from collections.abc import Sequence
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
    """The questions of one connection and the newest answer to each. Raises ValueError where `plan` does."""

    def __init__(self, values: Sequence[Value], limits: Limits) -> None:
        self._values, self._limits = values, limits
        self._live = _questions(plan((value.span for value in values), limits))
        self._parked: dict[Span, Answer] = {}
        self._turn = 0
        self._layout = _Layout(values, [])

    def due(self) -> list[Question]:
        """What to ask in this read: everything that the device gives, and one of the values that it refused."""
        if not self._parked:
            return self._live
        self._turn = (self._turn + 1) % len(self._parked)
        return [*self._live, list(self._parked.values())[self._turn].question]

    def parts(self, answer: Answer) -> list[Question]:
        """What to ask in place of a question whose range the device does not know; none when it is to be taken."""
        return _questions(split(answer.question.request, self._limits)) if answer.unknown_address else []

    def take(self, answers: Sequence[Answer], into: Image) -> None:
        """Fill `into`, one entry for each value, from the answers to all that was due or to its parts."""
        live: list[Answer] = []
        recovered = False
        for answer in answers:
            span = answer.question.request.spans[0]
            refused_again = span in self._parked and isinstance(answer.reply, Refused)
            if answer.unknown_address or refused_again:  # a single value: of several, the parts were asked instead
                self._parked[span] = answer
            else:
                live.append(answer)
                recovered |= self._parked.pop(span, None) is not None
        self._live = [answer.question for answer in live]
        known = [*live, *self._parked.values()]
        questions = [answer.question for answer in known]
        if questions != self._layout.questions:
            self._layout = _Layout(self._values, questions)
        self._layout.fill(into, known)
        if recovered:
            self._live = _questions(plan((span for q in self._live for span in q.request.spans), self._limits))


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
        into.values[:] = self._decoder.decode(np.frombuffer(wire, np.uint8))
        into.arrivals[:] = np.array([a.arrival for a in answers]).take(self._question_of)
        into.source_timestamps[:] = np.array([a.timestamp for a in answers], np.int64).take(self._question_of)
        statuses = [a.reply.status if isinstance(a.reply, Refused) else int(StatusCode.GOOD) for a in answers]
        if any(statuses):
            into.statuses[:] = np.array(statuses, np.uint32).take(self._question_of)
            into.values[into.statuses >= StatusCode.BAD] = np.nan
        else:
            into.statuses[:] = StatusCode.GOOD


def _questions(requests: Sequence[Request]) -> list[Question]:
    return [Question(request, read_request(request)) for request in requests]
