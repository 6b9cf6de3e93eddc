"""What every plug-in must hold to, as tests: ours and anybody else's.

    python -m rbtm_bench.contract                              # ours
    python -m rbtm_bench.contract --config-dir DIR             # ours and those of DIR
    python -m rbtm_bench.contract --config-dir DIR --plugin backend=mine

``DIR`` is laid out like our own configs (``DIR/backend/mine.yaml`` is ``backend=mine``). More words
go to pytest. The same as a plug-in of pytest, to be combined with other tests:

    pytest -p rbtm_bench.contract.plugin --pyargs rbtm_bench.contract --config-dir DIR

Every assertion says what is wrong and what is expected instead.
"""
