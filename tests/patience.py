"""How long a test waits for something that is certain to come on a sound machine, however busy.

Here: the one limit of all such waits. It ends a test that would hang; how fast anything is, no test asserts.
"""

HANG_S = 600.0
