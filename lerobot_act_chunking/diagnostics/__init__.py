"""Instruments: what a policy, its execution or its data are like, before a robot moves.

Each is built on `core` and on no other instrument. A small one is a module (`examples/own_instrument.py` is
one in 60 lines); the others are packages with the same files::

    settings.py    what is requested: Settings
    diagnosis.py   the way in: diagnose(settings) -> Report
    measuring.py   from what was read to the report
    verdict.py     the answer in words
    report.py      everything that was found: a `core.report.Report`, with a verdict, reasons and JSON
    terminal.py    print_report(report, console)
    plots.py       plot_report(report, path)

Commands parse options into settings and hand the report to `cli.reporting.finish`.
"""
