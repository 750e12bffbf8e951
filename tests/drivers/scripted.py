"""A serial line that answers whatever it is told to. Not a test."""


class ScriptedPort:
    """A `BytePort` with a list of answers, handed out one a read; what is sent is noted.

    Args:
        clock: Passes the time that a read waits in vain.
        answers: Bytes, in order.
    """

    def __init__(self, clock, answers):
        self.clock, self.answers = clock, list(answers)
        self.sent = []

    def write(self, data, timeout_s):
        self.sent.append(data)

    def read(self, max_bytes, timeout_s):
        if timeout_s > 0 and self.answers:
            return self.answers.pop(0)
        self.clock.sleep_s(timeout_s)
        return b""

    def close(self):
        pass
