"""Prometheus understands what services say and what deploy/ asks of them, and both speak of the same metrics."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.deploy.units import DEPLOY, units
from tests.docs.test_docs import page
from tests.scrapes import every_text, values

PROMETHEUS = DEPLOY / "prometheus"
RULES = [rule for group in yaml.safe_load((PROMETHEUS / "rules.yml").read_text())["groups"] for rule in group["rules"]]
TESTS = yaml.safe_load((PROMETHEUS / "rules_test.yml").read_text())["tests"]
DASHBOARD = json.loads((DEPLOY / "grafana" / "fleet.json").read_text(encoding="utf-8"))
NAME = re.compile(r"\b(?:fleet_\w+|process_\w+|python_\w+)\b")

with_promtool = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="promtool is not installed: it comes with Debian's package prometheus"
)


def promtool(*words: str, told: str = "", folder: Path = PROMETHEUS) -> str:
    done = subprocess.run(
        ["promtool", *words], input=told, capture_output=True, text=True, cwd=folder, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def panels() -> list[dict[str, Any]]:
    return [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]


def queries() -> dict[str, str]:
    """Expressions of the dashboard by panel and line, what Grafana fills in filled in."""
    found = {}
    for panel in panels():
        for target in panel["targets"]:
            text = target["expr"].replace("$__rate_interval", "1m").replace("$instance", ".*")
            assert "$" not in text
            found[f"{panel['title']} {target['refId']}"] = text
    return found


def exported() -> set[str]:
    """Names of all that the services say, those of parts of histograms too."""
    return {name for text in every_text().values() for name, _ in values(text)}


def families() -> dict[str, tuple[str, set[str]]]:
    """Kind and labels of all families that the services say, by name."""
    found: dict[str, tuple[str, set[str]]] = {}
    for text in every_text().values():
        for name, kind in re.findall(r"^# TYPE (fleet_\w+) (\w+)$", text, re.M):
            own = {
                key for known, labels in values(text) if re.fullmatch(rf"{name}(_bucket)?", known) for key, _ in labels
            }
            found[name] = kind, own - {"le"}
    return found


def test_every_metric_that_is_asked_for_exists() -> None:
    asked = {name for rule in RULES for name in NAME.findall(rule["expr"])}
    asked |= {name for query in queries().values() for name in NAME.findall(query)}
    asked |= {name for test in TESTS for series in test["input_series"] for name in NAME.findall(series["series"])}
    variables = DASHBOARD["templating"]["list"]
    asked |= {name for variable in variables for name in NAME.findall(variable.get("definition", ""))}
    assert len(asked) > 20
    assert asked - exported() == set()


def test_every_label_that_is_asked_for_exists() -> None:
    """Of selectors: a label that no series has selects nothing, in silence."""
    for text in (*(rule["expr"] for rule in RULES), *queries().values()):
        for name, inside in re.findall(r"\b(fleet_\w+)\{([^}]*)\}", text):
            known = {
                key
                for family in every_text().values()
                for n, labels in values(family)
                if n == name
                for key, _ in labels
            }
            assert set(re.findall(r"(\w+)=", inside)) <= known | {"job", "instance"}, text


def test_every_metric_is_on_its_page_and_no_other() -> None:
    text = page("how-to/monitor.md")
    rows = re.findall(r"^\| `(fleet_\w+)` \| (\w+) \| ([^|]+) \|", text, re.M)
    listed = {name: (kind, set(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}
    assert len(listed) == len(rows)
    assert listed == families()


def test_every_alert_is_on_its_page_and_says_what_to_do() -> None:
    text = page("how-to/monitor.md")
    names = [rule["alert"] for rule in RULES]
    assert re.findall(r"^\| `(Fleet\w+)` \|", text, re.M) == names
    for rule in RULES:
        assert rule["labels"]["severity"] in ("page", "ticket")
        assert set(rule["annotations"]) == {"summary", "action"}


def test_every_alert_is_seen_to_fire_and_not_to_fire() -> None:
    for rule in RULES:
        seen = set()
        for test in TESTS:
            firing = [
                any(rule["alert"] in sample["labels"] for sample in moment["exp_samples"])
                for moment in test["promql_expr_test"]
            ]
            if any(firing):
                seen |= set(firing)
        assert seen == {True, False}, rule["alert"]


def test_a_port_is_the_same_wherever_it_is_named() -> None:
    jobs = yaml.safe_load((PROMETHEUS / "prometheus.yml").read_text())["scrape_configs"]
    asked = {job["job_name"]: [t for static in job["static_configs"] for t in static["targets"]] for job in jobs}
    for unit in units():
        words = unit.command()
        if "--metrics" in words:
            assert asked[unit.path.stem] == [f"127.0.0.1:{words[words.index('--metrics') + 1]}"]
    assert set(asked) == {"fleet-reach", "fleet-side-info", "fleet-agent"}


def test_the_dashboard_is_one_that_grafana_can_draw() -> None:
    every = DASHBOARD["panels"]
    assert len({panel["id"] for panel in every}) == len(every)
    assert {panel["type"] for panel in every} == {"row", "stat", "timeseries", "heatmap"}
    taken: dict[tuple[int, int], str] = {}
    for panel in every:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24
        for x in range(place["x"], place["x"] + place["w"]):
            for y in range(place["y"], place["y"] + place["h"]):
                assert taken.setdefault((x, y), panel["title"]) == panel["title"]
    for panel in panels():
        assert panel["targets"]
        assert {panel["datasource"]["uid"], *(t["datasource"]["uid"] for t in panel["targets"])} == {"${datasource}"}
    assert [v["name"] for v in DASHBOARD["templating"]["list"]] == ["datasource", "instance"]


def test_grafana_is_told_where_prometheus_and_the_dashboard_are() -> None:
    folder = DEPLOY / "grafana" / "provisioning"
    (source,) = yaml.safe_load((folder / "datasources" / "prometheus.yml").read_text())["datasources"]
    assert (source["type"], source["access"]) == ("prometheus", "proxy")
    (provider,) = yaml.safe_load((folder / "dashboards" / "fleet.yml").read_text())["providers"]
    assert provider["type"] == "file"
    assert provider["options"]["path"] in page("how-to/monitor.md")


@with_promtool
@pytest.mark.parametrize("kind", ["reach", "side-info", "agent"])
def test_promtool_finds_nothing_wrong_with_what_a_service_says(kind: str) -> None:
    assert promtool("check", "metrics", told=every_text()[kind]) == ""


@with_promtool
def test_promtool_understands_configuration_and_rules() -> None:
    assert f"{len(RULES)} rules found" in promtool("check", "config", "prometheus.yml")


@with_promtool
@pytest.mark.slow
def test_promtool_sees_each_alert_fire_when_it_should() -> None:
    assert "SUCCESS" in promtool("test", "rules", "rules_test.yml")


@with_promtool
def test_promtool_understands_each_query_of_the_dashboard(tmp_path: Path) -> None:
    rules = [{"record": f"query:{i}", "expr": query} for i, query in enumerate(queries().values())]
    (tmp_path / "queries.yml").write_text(yaml.safe_dump({"groups": [{"name": "dashboard", "rules": rules}]}))
    assert f"{len(rules)} rules found" in promtool("check", "rules", "queries.yml", folder=tmp_path)
    rules[0]["expr"] += ")"
    (tmp_path / "wrong.yml").write_text(yaml.safe_dump({"groups": [{"name": "dashboard", "rules": rules}]}))
    with pytest.raises(AssertionError, match="could not parse expression"):
        promtool("check", "rules", "wrong.yml", folder=tmp_path)
