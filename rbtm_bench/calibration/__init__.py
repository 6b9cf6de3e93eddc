"""Which model scan to take: what pairs of scans predict, and what runs show.

The method, a file a step: ``track`` (what is known of every scan), ``reference`` (motions known
between scans), ``sampling`` (pairs across gaps and revisits, calibration and report apart),
``guesses`` (where registrations start), ``measuring`` (scores and registrations, in parallel),
``rates`` (success and errors over similarity), ``roc`` (how well a score predicts success),
``knee`` (whether errors rise abruptly), ``drift`` (what a chain of pairs drifts), ``shortlist``
(the settings that drift least), ``trial`` (which are run, the advice and whether it stands),
``tables`` and ``report`` (what is written).
docs/calibration.md has the definitions and formulas.
"""
