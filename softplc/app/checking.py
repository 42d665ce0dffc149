"""What `check` and `health` find out: what a configuration means, what its sources answer, whether softplc scans."""

import asyncio
import math
import os
import statistics
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from softplc.app.hints import Looked, hints, usable
from softplc.app.layout import SourceLayout, TaskLayout, build_layout
from softplc.clock import Clock, SystemClock
from softplc.config.models import Config
from softplc.errors import ConfigError, LinkError
from softplc.interfaces import Driver
from softplc.sample import Sample, StatusCode, quality, status_name
from softplc.tags import Image

_FIRST_DATA = 5.0  # seconds that a subscription gets for its first values
_LOOK = 1.0  # seconds that every source is looked at after that
_LOOKS = 20  # reads in this time, at the most


def describe(config: Config) -> list[dict[str, Any]]:
    """One row for each axis: where it reads, how often, with which observer."""
    rows = []
    for axis in config.axes:
        task = config.task_of(axis)
        rows.append(
            {
                "axis": axis.name,
                "task": task.name,
                "period_ms": task.period_ms,
                "source": axis.input.source,
                "tag": str(axis.input),
                "unit": axis.unit,
                "observer": axis.observer.type,
            }
        )
    return rows


def missing_secrets(config: Config) -> list[str]:
    """One text for each secret that is not where the configuration says; a run would end at it."""
    users: list[tuple[str, Any]] = [
        (f"source {source.name}", getattr(source, "user", None)) for source in config.sources
    ]
    for publisher in config.publishers:
        users += [(f"{publisher.type} publisher", user) for user in getattr(publisher, "users", ())]
    texts = []
    for owner, user in users:
        try:
            if user is not None:
                user.password.read()
        except ConfigError as error:
            texts.append(f"{owner}, user {user.name}: {error}")
    return texts


def certificate_remarks(config: Config) -> list[str]:
    """One text for each certificate of a server that is, or soon will be, of no use for its date."""
    clock = SystemClock()
    try:
        now = datetime.fromtimestamp(clock.utc_ns() / 1e9, UTC)
    finally:
        clock.close()
    texts = []
    for publisher in config.publishers:
        security = getattr(publisher, "security", None)
        if security is not None:
            from softplc.publishers.opcua.own_certificate import remarks  # noqa: PLC0415  only where there is one

            texts += [f"{publisher.type} publisher: {text}" for text in remarks(security, now)]
    return texts


class Found(NamedTuple):
    """What the sources answered: rows of tags, texts about them, and the median ms of a read by task and source."""

    rows: list[dict[str, Any]]
    texts: list[str]
    answers: dict[tuple[str, str], float]


def read_once(config: Config) -> Found:
    """One row for each tag that softplc would read: value, unit, status, source timestamp, age in seconds, and how
    many new samples a second came while it was looked at (at most 20 looks).

    A source that cannot be reached gives rows with the reason under `error`. The texts beside the rows are what the
    drivers have to say: what is wrong with a tag, and what works, but not as one would wish; and which values cannot
    be meant, with what would make sense instead.
    """
    return asyncio.run(_read_once(config))


async def _read_once(config: Config) -> Found:
    clock = SystemClock()
    units = {f"{axis.name}.Raw": axis.unit for axis in config.axes}
    ranges = {f"{axis.name}.Raw": axis.range for axis in config.axes}
    layout = build_layout(config)
    sources = [(task, source) for task in layout.tasks for source in task.sources]
    try:
        # All are built before the first one opens: the import of asyncua would outlast the time limits of the others.
        drivers = [_built(task, source, clock) for task, source in sources]
        results = await asyncio.gather(
            *(
                _read_source(task, source, driver, units, ranges, clock)
                for (task, source), driver in zip(sources, drivers, strict=True)
                if not isinstance(driver, ConfigError)
            ),
            return_exceptions=True,
        )
    finally:
        clock.close()
    unfit = [str(result) for result in (*drivers, *results) if isinstance(result, ConfigError)]
    if unfit:
        raise ConfigError(*unfit)
    found = Found([], [], {})
    for result in results:
        if isinstance(result, BaseException):
            raise result
        found.rows.extend(result.rows)
        found.texts.extend(result.texts)
        found.answers.update(result.answers)
    return found


def _built(task: TaskLayout, layout: SourceLayout, clock: Clock) -> Driver | ConfigError:
    """The driver of a source, not open yet, or what keeps it from being one."""
    source = layout.source
    try:
        driver: Driver = source.build(list(layout.readings), layout.writings, clock, task.task.period_ms / 1e3)
    except ConfigError as problem:
        return ConfigError(f"source {source.name}: {problem}")
    return driver


async def _read_source(
    task: TaskLayout,
    layout: SourceLayout,
    driver: Driver,
    units: dict[str, str],
    ranges: dict[str, tuple[float, float] | None],
    clock: Clock,
) -> Found:
    source = layout.source
    image = Image(len(layout.readings))
    error = ""
    texts: list[str] = []
    answers: dict[tuple[str, str], float] = {}
    changes = [0.0] * len(layout.readings)
    pairs = zip(layout.reading_names, layout.readings, strict=True)
    looked = [Looked(name, tag, ranges.get(name)) for name, tag in pairs]
    try:
        async with asyncio.timeout(getattr(source, "connect_timeout_ms", 10_000.0) / 1e3):
            await driver.open()
        await _first_data(driver, image, clock)
        changes, took = await _look(driver, image, looked, clock, task.task.period_ms / 1e3)
    except (LinkError, TimeoutError) as problem:
        error = str(problem) or "no answer within the time limit"
        image.fail(StatusCode.BAD_NO_COMMUNICATION)
    else:
        texts = [f"{source.name}: {text}" for text in (*driver.problems, *driver.remarks)]
        answers = {(task.task.name, source.name): took}
    finally:
        await driver.close()
    now = clock.utc_ns()
    if not error:
        positions = [each for each in looked if each.name in ranges]
        texts += await hints(source, positions, clock, task.task.period_ms / 1e3)
    rows = [
        _row(name, source.name, str(tag), units.get(name, ""), image.sample(position), now, error)
        | {"new_per_s": changes[position]}
        for position, (name, tag) in enumerate(zip(layout.reading_names, layout.readings, strict=True))
    ]
    return Found(rows, texts, answers)


async def _first_data(driver: Any, image: Image, clock: Clock) -> None:
    """Read until every tag has its first data; a subscription needs a moment."""
    deadline = clock.monotonic() + _FIRST_DATA
    while True:
        await driver.read(image)
        waiting = bool((image.statuses == StatusCode.BAD_WAITING_FOR_INITIAL_DATA).any())
        if not waiting or clock.monotonic() > deadline:
            return
        await clock.sleep_until(clock.monotonic() + 0.05)


async def _look(
    driver: Any, image: Image, looked: list[Looked], clock: Clock, period: float
) -> tuple[list[float], float]:
    """Read for a while, keeping what was seen; new samples a second of each tag, and the median ms of a read."""
    took: list[float] = []
    begun = clock.monotonic()
    counts = [0] * len(looked)
    before = [_news(image, position) for position in range(len(looked))]
    while clock.monotonic() - begun < _LOOK:
        await clock.sleep_until(clock.monotonic() + max(period, _LOOK / _LOOKS))
        asked = clock.monotonic()
        await driver.read(image)
        took.append((clock.monotonic() - asked) * 1e3)
        for position, each in enumerate(looked):
            if not usable(image, position):
                continue
            each.values.append(float(image.values[position]))
            stamp = int(image.source_timestamps[position])
            each.ahead = (stamp - clock.utc_ns()) / 1e9 if stamp else 0.0
            news = _news(image, position)
            counts[position] += news != before[position]
            before[position] = news
    seconds = max(clock.monotonic() - begun, 1e-9)
    return [round(count / seconds, 1) for count in counts], statistics.median(took)


def _news(image: Image, position: int) -> tuple[float, int]:
    return float(image.values[position]), int(image.statuses[position])


def _row(name: str, source: str, tag: str, unit: str, sample: Sample, now: int, error: str) -> dict[str, Any]:
    stamp = sample.source_timestamp
    return {
        "tag": name,
        "source": source,
        "address": tag,
        "value": None if math.isnan(sample.value) else sample.value,
        "unit": unit,
        "status": status_name(sample.status),
        "quality": quality(sample.status).name.capitalize(),
        "source_timestamp": None if stamp is None else utc_text(stamp),
        "age_s": None if stamp is None else round((now - stamp) / 1e9, 3),
        "error": error,
    }


def utc_text(nanoseconds: int) -> str:
    """A time stamp as ISO 8601 text with microseconds, UTC."""
    from datetime import UTC, datetime  # noqa: PLC0415  formatting only; the time itself comes from the caller

    return datetime.fromtimestamp(nanoseconds // 1000 / 1e6, UTC).isoformat(timespec="microseconds")


def configured_path(argument: Path | None) -> Path | None:
    """The configuration file of a command that may go without: the argument, or what SOFTPLC_CONFIG names."""
    if argument is not None:
        return argument
    named = os.environ.get("SOFTPLC_CONFIG")
    return Path(named) if named else None
