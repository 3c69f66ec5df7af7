"""Prometheus itself, with the configuration, rules and dashboard of docs/monitoring."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.parse import urlencode
from urllib.request import urlopen

import pytest

from tests.support.nodes import RADIAL, ROOT, free_address, process
from tests.support.waiting import PATIENCE_S, until

MONITORING = ROOT / "docs" / "monitoring"
missing = [name for name in ("prometheus", "promtool") if shutil.which(name) is None]
pytestmark = pytest.mark.skipif(missing != [], reason=f"needs {missing} (Debian: prometheus)")

# What a node sends, in promtool's notation, and the time at which the alert fires.
FIRING: dict[str, tuple[dict[str, str], str]] = {
    "TelepulseSilent": ({'telepulse_up{job="telepulse",instance="a"}': "1 1 0 0"}, "3m"),
    "TelepulseFault": ({'telepulse_state{telepulse_state="fault",instance="a"}': "0 1"}, "1m"),
    "TelepulseTipMayPress": (
        {'telepulse_finger{name="although # mN were measured",instance="a"}': "1"},
        "0m",
    ),
    "TelepulseStale": ({'telepulse_state{telepulse_state="stale",instance="a"}': "1 1"}, "1m"),
    "TelepulseLoss": (
        {
            'telepulse_samples_total{outcome="played",instance="a"}': "0+900x9",
            'telepulse_samples_total{outcome="predicted",instance="a"}': "0+80x9",
            'telepulse_samples_sent_total{instance="a"}': "0+1000x9",
        },
        "9m",
    ),
    "TelepulseDeadline": ({'telepulse_deadline_alarm{instance="a"}': "0 1 0"}, "2m"),
    "TelepulsePrediction": ({'telepulse_prediction_alarm{instance="a"}': "0 1 0"}, "2m"),
}


def promtool(*arguments: str) -> str:
    ended = subprocess.run(
        ["promtool", *arguments], capture_output=True, encoding="utf-8", check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def test_the_configuration_and_the_rules_are_valid() -> None:
    assert "8 rules found" in promtool("check", "config", str(MONITORING / "prometheus.yml"))


def test_each_alert_fires_and_none_of_a_good_run(tmp_path: Path) -> None:
    """Compute the rules in Prometheus's own virtual time."""
    good = {
        'telepulse_up{job="telepulse",instance="a"}': "1x9",
        'telepulse_state{telepulse_state="fault",instance="a"}': "0x9",
        'telepulse_finger{name="pressed with # mN (model, no drive)",instance="a"}': "1x9",
        'telepulse_samples_total{outcome="played",instance="a"}': "0+1000x9",
        'telepulse_samples_sent_total{instance="a"}': "0+1000x9",
        'telepulse_deadline_alarm{instance="a"}': "0x9",
    }
    # The interval is half a minute where an alert looks back over one.
    cases = [
        (name, series, time, [name] if name == alert else [])
        for alert, (series, time) in {**FIRING, "": (good, "8m")}.items()
        for name in FIRING
        if name == alert or not alert
    ]
    tests = [
        {
            "interval": "30s" if name == "TelepulseLoss" else "1m",
            "input_series": [{"series": key, "values": values} for key, values in series.items()],
            "promql_expr_test": [
                {
                    "expr": f'count(ALERTS{{alertname="{name}",alertstate="firing"}}) or vector(0)',
                    "eval_time": "4m" if name == "TelepulseLoss" and firing else time,
                    "exp_samples": [{"labels": "{}", "value": len(firing)}],
                }
            ],
        }
        for name, series, time, firing in cases
    ]
    table = {"rule_files": [str(MONITORING / "telepulse.rules.yml")], "tests": tests}
    # JSON is YAML.
    path = tmp_path / "alerts.yml"
    path.write_text(json.dumps(table | {"evaluation_interval": "15s"}), encoding="utf-8")
    promtool("test", "rules", str(path))


class Server:
    """Prometheus, in a process."""

    def __init__(self, port: str) -> None:
        self._url = f"http://127.0.0.1:{port}/api/v1/"

    def get(self, what: str, **query: str) -> Any:
        """Return the data of an answer; None while the server starts."""
        try:
            with urlopen(f"{self._url}{what}?{urlencode(query)}", timeout=PATIENCE_S) as answer:
                table = json.load(answer)
        except URLError:
            return None
        assert table["status"] == "success"
        return table["data"]

    def found(self, expression: str) -> list[Any]:
        data = self.get("query", query=expression)
        return [] if data is None else data["result"]


@contextmanager
def prometheus(folder: Path, *targets: str) -> Iterator[Server]:
    """Run Prometheus with the page's configuration, its targets and interval replaced."""
    text = (MONITORING / "prometheus.yml").read_text(encoding="utf-8")
    assert '"127.0.0.1:9100", "127.0.0.1:9101"' in text
    text = text.replace('"127.0.0.1:9100", "127.0.0.1:9101"', ", ".join(map(json.dumps, targets)))
    config = folder / "prometheus.yml"
    config.write_text(text.replace("scrape_interval: 5s", "scrape_interval: 1s"), encoding="utf-8")
    shutil.copy(MONITORING / "telepulse.rules.yml", folder)
    port = free_address().rpartition(":")[2]
    command = [
        *("prometheus", "--config.file", str(config), "--storage.tsdb.path", str(folder / "data")),
        *("--web.listen-address", f"127.0.0.1:{port}", "--log.level", "warn"),
    ]
    with subprocess.Popen(command, cwd=folder) as server:
        try:
            yield Server(port)
        finally:
            server.terminate()


def test_it_scrapes_both_nodes_and_answers_every_query_of_the_dashboard(tmp_path: Path) -> None:
    address, targets = free_address(), [free_address()[6:] for _ in range(2)]
    dashboard = json.loads((MONITORING / "grafana.json").read_text(encoding="utf-8"))
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    assert len(queries) == 10
    with ExitStack() as stack:
        nodes = (
            ("sensing_node.cli", "--bind", address),
            ("display_node.cli", "--connect", address, "--no-screen"),
        )
        for (module, *arguments), target in zip(nodes, targets, strict=True):
            stack.enter_context(process(module, str(RADIAL), *arguments, "--metrics", target))
        server = stack.enter_context(prometheus(tmp_path, *targets))
        until(lambda: len(server.found('up{job="telepulse"} == 1')) == 2)
        until(lambda: server.found('telepulse_state{telepulse_state="playing"} == 1'))
        (groups,) = server.get("rules")["groups"]
        assert len(groups["rules"]) == 8
        for query in queries:
            # A recorded rule has its first value after a minute; its expression has one earlier.
            rule = next((r["query"] for r in groups["rules"] if r["name"] == query), query)
            until(lambda rule=rule: server.found(rule))  # type: ignore[misc]
        assert server.get("query", query=dashboard["annotations"]["list"][0]["expr"]) is not None
