"""The page in a real browser, of a display that publishes a fault."""

from display_node.fault_advice import advise
from protocol.run_summary import Summary
from tests.support.browser import Visit
from tests.support.nodes import free_address
from tests.support.telemetry_publisher import publishing
from tests.support.waiting import until
from tests.system.view.test_server import serving

FAULT = "drive: no answer for 403 ms"
FINGER = "pressed with 245 mN, the drive does not answer"


def test_a_fault_is_named_once_with_what_to_do_and_what_is_measured(visit: Visit) -> None:
    address = free_address()
    with publishing(address) as publisher, serving(address) as server, visit(server.url) as page:
        publisher.begin()
        publisher.publish(400)
        note = page.locator("#state-note")

        def shown() -> bool:
            """Publish on, as a display does: what is not current has its age instead."""
            for _ in range(20):
                publisher.tick()
            publisher.status("fault", Summary(faults=[FAULT], finger=FINGER))
            return str(note.inner_text()).endswith(f"; finger: {FINGER}")

        until(shown)
        assert page.locator("#state").inner_text() == "fault"
        alarm = page.locator(f"#alarms li[data-name='fault: {FAULT}']")
        assert alarm.inner_text().startswith(f"fault: {FAULT} – {advise(FAULT)}")
        assert page.locator("#events li", has_text=f"fault: {FAULT}: {advise(FAULT)}").count() == 1
        assert "at rest" not in page.locator("body").inner_text()
