"""The force loop under the finger: controller, observer, margins and safety."""
