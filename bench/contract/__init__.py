"""What a denoiser or a policy must do, as tests for one's own: `pytest --bench-contract MODULE:NAME`.

The tests are in `denoiser_contract.py` and `policy_contract.py`; `bench.contract.collect` brings them into a session.
"""
