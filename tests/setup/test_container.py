"""The container image, the compose file and the systemd unit, as far as they can be judged without an engine."""

import json
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
DOCKERFILE = (DOCKER / "Dockerfile").read_text()
FINAL_STAGE = DOCKERFILE.split("\nFROM ")[-1]
SERVICE = (DOCKER / "softplc.service").read_text()


def load(name: str) -> Any:
    """A YAML file of docker/ as plain data, anchors merged."""
    return YAML(typ="safe").load(DOCKER / name)


def compose() -> dict[str, Any]:
    """The services of compose.yaml by name."""
    return dict(load("compose.yaml")["services"])


def test_hadolint_finds_nothing_in_the_dockerfile():
    hadolint = shutil.which("hadolint", path=sysconfig.get_path("scripts")) or shutil.which("hadolint")
    if hadolint is None:
        pytest.skip("hadolint is not installed")
    done = subprocess.run([hadolint, str(DOCKER / "Dockerfile")], capture_output=True, text=True, check=False)

    assert (done.returncode, done.stdout) == (0, "")


def test_image_runs_unprivileged_without_shell_and_asks_its_own_health():
    assert "USER 10001:10001" in FINAL_STAGE
    assert json.loads(re.findall(r"^ENTRYPOINT (.*)", FINAL_STAGE, re.M)[0]) == ["softplc"]
    assert json.loads(re.findall(r"^CMD (.*)", FINAL_STAGE, re.M)[0]) == ["run", "/etc/softplc/softplc.yaml"]
    assert re.search(r'^HEALTHCHECK .*CMD \["softplc", "health"\]$', FINAL_STAGE, re.M)
    assert "STOPSIGNAL SIGTERM" in FINAL_STAGE
    assert not re.search(r"\buv\b|\bpip\b|^RUN", FINAL_STAGE, re.M)


def test_everything_that_the_image_copies_exists_and_reaches_the_builder():
    allowed = re.findall(r"^!(\S+)", (ROOT / ".dockerignore").read_text(), re.M)
    sources = [
        source for line in re.findall(r"^COPY (?!--from)(.*)", DOCKERFILE, re.M) for source in line.split()[:-1]
    ]
    assert sorted(sources) == sorted(allowed)
    for source in sources:
        assert (ROOT / source).exists(), source


def test_image_takes_uv_alone_from_the_lock_by_the_same_pattern_as_its_recipe_says():
    recipe = re.search(r"sed -n '(.*)' requirements\.lock", DOCKERFILE)
    assert recipe is not None
    done = subprocess.run(
        ["sed", "-n", recipe[1], str(ROOT / "requirements.lock")], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"uv==\S+ \\\n( +--hash=sha256:\w{64}( \\)?\n)+", done.stdout)


def test_compose_services_are_read_only_unprivileged_and_checked():
    for name, service in compose().items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["healthcheck"]["test"][0] == "CMD", name


def test_compose_publishes_on_loopback_alone_and_only_what_softplc_serves():
    ports = {name: service.get("ports", []) for name, service in compose().items()}
    served = {publisher["port"] for publisher in load("softplc.yaml")["publishers"]}

    assert ports["plc"] == []
    assert {re.fullmatch(r"127\.0\.0\.1:(\d+):\1", port)[1] for port in ports["softplc"]} == set(map(str, served))


def test_compose_refers_to_files_that_exist_and_runs_what_it_mounts():
    for name, service in compose().items():
        assert (DOCKER / service["build"]["context"] / service["build"]["dockerfile"]).is_file()
        source, target, mode = service["volumes"][0].split(":")
        assert (DOCKER / source).is_file(), name
        assert mode == "ro"
        assert service["command"][1] == target


def test_softplc_of_compose_reads_the_tags_that_its_plc_serves():
    config, scenario = load("softplc.yaml"), load("scenario.yaml")
    hosts = {source.get("url") or "{host}:{port}".format(**source["transport"]) for source in config["sources"]}

    assert hosts == {f"opc.tcp://plc:{scenario['opcua']['port']}", f"plc:{scenario['modbus']['port']}"}
    assert [axis["name"] for axis in config["axes"]] == [axis["name"] for axis in scenario["axes"]]
    demo = YAML(typ="safe").load((ROOT / "config" / "demo.yaml").read_text(encoding="utf-8"))
    assert [axis["input"] for axis in config["axes"]] == [axis["input"] for axis in demo["axes"]]
    assert {part["host"] for part in [*config["publishers"], scenario["opcua"], scenario["modbus"]]} == {"0.0.0.0"}


def test_configuration_of_compose_passes_softplc_check():
    done = subprocess.run(
        [sys.executable, "-m", "softplc", "check", str(DOCKER / "softplc.yaml")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr.strip().endswith("valid")) == (0, True), done.stderr


def test_scenario_of_compose_is_one():
    from softplc.emulator.scenario import Scenario

    Scenario.model_validate_json(json.dumps(load("scenario.yaml")))


def test_unit_exposes_no_more_than_2_0_by_systemd_s_own_judgement():
    analyze = need_systemd_analyze()
    done = subprocess.run(
        [analyze, "security", "--no-pager", "--offline=true", "--threshold=20", str(DOCKER / "softplc.service")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-300:]
    assert float(re.findall(r"Overall exposure level for softplc.service: (\d+\.\d)", done.stdout)[0]) <= 2.0


def test_unit_and_its_commented_lines_are_directives_that_systemd_knows(tmp_path: Path):
    analyze = need_systemd_analyze()
    plain = re.sub(r"ExecStart=\S+", "ExecStart=/bin/true", SERVICE)
    everything = re.sub(r"(?m)^#(?=[A-Z]\w+=)", "", plain)
    for number, text in enumerate((plain, everything)):
        unit = tmp_path / f"softplc{number}.service"
        unit.write_text(text)
        done = subprocess.run(
            [analyze, "verify", "--man=no", "--generators=no", str(unit)], capture_output=True, text=True, check=False
        )
        complaints = [line for line in done.stderr.splitlines() if unit.name in line]

        assert complaints == []


def test_unit_is_fed_by_the_scan_process_and_stays_down_on_a_wrong_configuration():
    from softplc.errors import ConfigError

    for line in ("Type=notify", "NotifyAccess=all", "WatchdogSec=10", "Restart=on-failure", "DynamicUser=yes"):
        assert f"\n{line}\n" in SERVICE
    assert f"\nRestartPreventExitStatus={ConfigError.exit_code}\n" in SERVICE
    assert "\n#AmbientCapabilities=CAP_NET_BIND_SERVICE\n" in SERVICE


def need_systemd_analyze() -> str:
    """Path of systemd-analyze; skips the test where systemd is not installed."""
    path = shutil.which("systemd-analyze")
    if path is None:
        pytest.skip("systemd-analyze is not installed")
    return path
