import os
import subprocess
import sys

import structlog

from softplc.app.realtime import apply_realtime
from softplc.config.models import RealTime


def warnings_of(options: RealTime) -> list[dict[str, object]]:
    with structlog.testing.capture_logs() as lines:
        apply_realtime(options)
    return [dict(line) for line in lines]


def test_a_cpu_that_is_not_there_is_one_warning_that_names_those_that_are():
    before = os.sched_getaffinity(0)
    (line,) = warnings_of(RealTime(cpu_affinity=(4095,)))
    assert line["option"] == "realtime.cpu_affinity"
    assert "choose among the CPUs" in str(line["cure"])
    assert os.sched_getaffinity(0) == before


def test_affinity_is_applied_where_permitted():
    code = (
        "import os; from softplc.app.realtime import apply_realtime; from softplc.config.models import RealTime\n"
        "cpu = min(os.sched_getaffinity(0)); apply_realtime(RealTime(cpu_affinity=(cpu,)))\n"
        "assert os.sched_getaffinity(0) == {cpu}"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_without_permission_each_option_is_a_warning_with_its_cure():
    code = (
        "import os, resource\n"
        "from softplc.app.logs import configure_logs; from softplc.app.realtime import apply_realtime\n"
        "from softplc.config.models import Log, RealTime\n"
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
        "resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))\n"
        "if os.geteuid() == 0: os.setgid(65534); os.setuid(65534)\n"
        "configure_logs(Log(format='json'), 'scan'); apply_realtime(RealTime(fifo_priority=50, lock_memory=True))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    lines = [line for line in done.stderr.splitlines() if "not applied" in line]
    assert len(lines) == 2
    assert "realtime.fifo_priority" in lines[0]
    assert "CAP_SYS_NICE" in lines[0]
    assert "realtime.lock_memory" in lines[1]
    assert "CAP_IPC_LOCK" in lines[1]
