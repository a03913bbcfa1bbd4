"""The exit statuses that all commands share. They tell a script what happened."""

EXIT_OK = 0  # everything that was requested was done
EXIT_FAILED = 1  # an expectation failed, a finding is a refusal, or an order was not carried out
EXIT_WRONG_INPUT = 2  # a wrong file, option or combination: nothing was started
EXIT_NO_ANSWER = 10  # no vehicle, agent, body or autopilot answered
EXIT_MIXED = 50  # some vehicles succeeded and some did not
EXIT_INTERRUPTED = 130  # Ctrl-C
EXIT_NO_READER = 141  # nobody reads the output any more; what SIGPIPE ends with in a shell
