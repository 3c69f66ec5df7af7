"""Between the tip's metres and a drive's own integers."""

from dataclasses import dataclass

from display_node.step_rate import StepCommand

LARGEST = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Units:
    """How a drive counts.

    step_m: travel of one (micro)step. per_step: the drive's position units in one step.
    per_step_rate: its velocity units in one step a second. direction: 1 where the drive's
    positive goes into the finger, −1 where it goes away. home_m: where its zero is, from first
    touch.
    """

    step_m: float
    per_step: float
    per_step_rate: float
    direction: int
    home_m: float

    def signed(self, command: StepCommand) -> float:
        """A command's speed in m/s."""
        return command.rate_hz * command.direction * self.step_m

    def velocity(self, speed_m_per_s: float) -> int:
        """A speed as the drive writes it, within 32 bits."""
        units = round(self.direction * speed_m_per_s / self.step_m * self.per_step_rate)
        return min(max(units, -LARGEST), LARGEST)

    def speed_m_per_s(self, velocity: int) -> float:
        """The speed that the drive's number stands for."""
        return self.direction * velocity / self.per_step_rate * self.step_m

    def position(self, position_m: float) -> int:
        """A tip position as the drive writes it, within 32 bits."""
        units = round(self.direction * (position_m - self.home_m) / self.step_m * self.per_step)
        return min(max(units, -LARGEST), LARGEST)

    def position_m(self, position: int) -> float:
        """The tip position that the drive's number stands for."""
        return self.direction * position / self.per_step * self.step_m + self.home_m
