from telepulse.reports.paper import comparison


def test_the_actuator_by_its_own_numbers() -> None:
    _, film_and_actuator = comparison.contradictions().tables
    computed = {row[0]: row[2:] for row in film_and_actuator.rows}
    assert computed["Natural frequency of eq 22"][0] == "0.41 Hz"
    volts, consequence = computed["Voltage for a pulse of 1 N through eq 22"]
    assert volts == "2462 V at the peak"
    assert "a pulse of 4.1 mN from peak to peak" in consequence
