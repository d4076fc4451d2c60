"""Contexts."""


class Context:
    """Whether rclpy was initialised and shut down."""

    domain_id: int | None = None

    def try_shutdown(self) -> None:
        self.domain_id = None
