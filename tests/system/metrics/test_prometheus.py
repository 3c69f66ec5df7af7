"""Prometheus itself, with the configuration, rules and dashboard of docs/monitoring."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.nodes import ROOT

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
