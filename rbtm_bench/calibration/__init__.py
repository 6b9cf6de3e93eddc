"""Error against similarity: which pairs of scans register well, and can a score tell beforehand?

The method, a file a step: ``track`` (what is known of every scan), ``reference`` (motions known
between scans), ``sampling`` (pairs across gaps and revisits, calibration and report apart),
``guesses`` (where registrations start), ``measuring`` (scores and registrations, in parallel),
``consistency`` (the stand-in where no truth is known), ``rates`` (success and errors over
similarity), ``roc`` (how well a score predicts success), ``knee`` (whether errors rise abruptly),
``advice`` (threshold and window for a wanted success), ``tables`` and ``report`` (what is written).
docs/calibration.md has the definitions and formulas.
"""
