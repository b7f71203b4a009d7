"""What settings become, with the real store and the real model on a disk."""

import asyncio
import math
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from bench.certified import AUTHORITIES, AUTHORITY_KEY, OTHER_AUTHORITY_KEY, UNIT, signer_of
from roadgrip.certificates import RevocationList, Role, issue_revocations
from roadgrip.errors import ConfigurationError, StoreError
from roadgrip.features import NEWEST_TABLE
from roadgrip.ledger import Action
from roadgrip.records import Advisory, AdvisoryReason, FrictionInterval
from roadgrip.section import GnssAnchor, build_section
from roadgrip.trust import credential_to_pem
from rsu_app.adapters.http.app import create_app
from rsu_app.adapters.store import standby
from rsu_app.bootstrap import (
    Parts,
    build,
    check_maps,
    load_sections,
    load_trust,
    observe,
    open_door,
    renew_trust,
    site_of_parts,
)
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.interval import IntervalPolicy
from rsu_app.domain.probing import ProbingPolicy
from rsu_app.observability import Metrics
from rsu_app.settings import load_settings
from rsu_app.usecases import FrictionPolicies
from tests.bundles import make_bundle
from tests.rsu_app.adapters.store.stories import make_entry
from tests.rsu_app.fakes import WaveringModel, make_passage
from tests.rsu_app.sites import passage_json


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_bundle(tmp_path / "bundle")
    return tmp_path


def parts_of(folder: Path, more: str = "", *, size_limit_bytes: int | None = None) -> Parts:
    config = folder / "rsu.toml"
    config.write_text(f'{more}\n[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n', encoding="utf-8")
    settings = load_settings(config)
    if size_limit_bytes is not None:  # smaller than anybody may choose, so that one passage is too many
        export = settings.export.model_copy(update={"size_limit_bytes": size_limit_bytes})
        settings = settings.model_copy(update={"export": export})
    sections = load_sections(settings)
    metrics = Metrics(version="0", section_ids=[s.section_id for s in sections])
    return build(settings, metrics=metrics, sections=sections)


async def posted(parts: Parts, count: int) -> list[httpx.Response]:
    app = create_app(site_of_parts(parts, endpoint=None, door=open_door(parts.settings)))
    (section, *_) = load_sections(parts.settings)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://unit") as client:
        return [
            await client.post(
                f"/v1/sections/{section.section_id}/passages",
                json=passage_json(make_passage(section, seed=seed, mu=0.45)),
            )
            for seed in range(count)
        ]


def test_a_restart_restores_the_window(folder):
    async def scenario() -> None:
        first = parts_of(folder)
        assert {answer.status_code for answer in await posted(first, 12)} == {200}
        before = first.unit.current_interval("long-turn")
        await first.unit.close()
        second = parts_of(folder)
        assert await second.unit.restore() == 12
        after = second.unit.current_interval("long-turn")
        assert isinstance(before, FrictionInterval)
        assert isinstance(after, FrictionInterval)
        assert (before.median_mu, before.passages_count) == (after.median_mu, after.passages_count)
        await second.unit.close()

    asyncio.run(scenario())


EXPORTS = '[export]\nenabled = true\nunit_name = "bend"\n'


@pytest.mark.parametrize(("more", "deleted_count"), [("", 2), (EXPORTS, 1)])
def test_what_nobody_exports_is_not_kept_for_long(folder, more, deleted_count):
    async def scenario() -> None:
        parts = parts_of(folder, more)
        for seed, days in enumerate((1.0, 30.0, 100.0)):
            await parts.store.append([make_entry(seed, received_unix_s=time.time() - 86_400.0 * days)])
        assert await parts.unit.prune() == deleted_count
        await parts.unit.close()

    asyncio.run(scenario())


@pytest.mark.parametrize(("more", "deleted_count"), [("", 0), (EXPORTS, 1)])
def test_what_is_kept_for_exports_stays_below_its_size(folder, more, deleted_count):
    async def scenario() -> None:
        parts = parts_of(folder, more, size_limit_bytes=1)
        await parts.store.append([make_entry(1, received_unix_s=time.time())])
        assert await parts.unit.prune() == deleted_count
        await parts.unit.close()

    asyncio.run(scenario())


def test_a_unit_that_runs_ahead_of_the_world_keeps_its_window_through_a_restart(folder):
    async def scenario() -> None:
        ahead = "[clock]\nspeedup_ratio = 500.0\n"
        first = parts_of(folder, ahead)
        await asyncio.sleep(0.05)
        assert {answer.status_code for answer in await posted(first, 12)} == {200}
        await first.unit.close()
        second = parts_of(folder, ahead)
        assert await second.unit.catch_up() == 12
        await second.unit.close()

    asyncio.run(scenario())


def test_a_unit_whose_database_cannot_be_opened_starts_and_takes_it_up_later(folder, monkeypatch):
    monkeypatch.setattr(standby, "RETRY_PERIOD_S", 0.0)

    async def scenario() -> None:
        (folder / "rsu.sqlite3").mkdir()
        parts = parts_of(folder)
        (refused,) = await posted(parts, 1)
        assert (refused.status_code, refused.json()["reason"]) == (503, "store_unavailable")
        readiness = await parts.unit.readiness()
        assert [check.ok for check in readiness.checks if check.name == "store"] == [False]
        assert any("unable to open" in check.detail for check in readiness.checks)
        advisory = parts.unit.current_advisory("long-turn")
        assert isinstance(advisory, Advisory)
        assert advisory.reason is AdvisoryReason.WINTER_SPEED_FEW_VEHICLES
        with pytest.raises(StoreError):
            await parts.unit.catch_up()
        await observe(parts)
        (folder / "rsu.sqlite3").rmdir()
        await parts.unit.catch_up()
        assert (await parts.unit.readiness()).ready
        assert [answer.status_code for answer in await posted(parts, 1)] == [200]
        assert any("only later" in note for note in parts.store.notes)
        actions = [entry.action for entry in await parts.store.ledger(limit_count=10)]
        assert actions == [Action.LIVE, Action.LEDGER_BEGUN]
        await parts.unit.close()

    asyncio.run(scenario())


def test_a_refused_bundle_is_named_in_readiness(folder):
    async def scenario() -> None:
        manifest = folder / "bundle" / "manifest.json"
        manifest.write_text(
            manifest.read_text(encoding="utf-8").replace(NEWEST_TABLE.digest, "0" * 16), encoding="utf-8"
        )
        parts = parts_of(folder)
        (check, *_) = (await parts.unit.readiness()).checks
        assert not check.ok
        assert NEWEST_TABLE.digest in check.detail
        assert "0" * 16 in check.detail
        await parts.unit.close()

    asyncio.run(scenario())


def test_gauges_show_the_interval_and_nothing_where_there_is_none(folder):
    async def scenario() -> None:
        parts = parts_of(folder)

        def shown(metric: str) -> float:
            value = parts.metrics.registry.get_sample_value(metric, {"section": "long-turn"})
            assert value is not None
            return value

        await observe(parts)
        assert math.isnan(shown("roadgrip_interval_mu_new"))
        assert math.isnan(shown("roadgrip_interval_at_least"))
        assert shown("roadgrip_window_passages") == 0
        await posted(parts, 12)
        await observe(parts)
        assert shown("roadgrip_interval_mu_new") == pytest.approx(0.5, abs=1e-5)
        assert shown("roadgrip_interval_at_least") == 0
        assert shown("roadgrip_window_passages") == 12
        assert parts.metrics.registry.get_sample_value("roadgrip_store_passages") == 12
        assert parts.metrics.registry.get_sample_value("roadgrip_ready") == 1
        await parts.unit.close()

    asyncio.run(scenario())


def test_a_gauge_shows_that_too_few_vehicles_name_a_friction(folder):
    async def scenario() -> None:
        parts, model = parts_of(folder), WaveringModel()
        parts.unit.switch_model(model)
        model.wavers = True
        (section,) = load_sections(parts.settings)
        for seed in range(12):
            await parts.unit.ingest_passage(make_passage(section, seed=seed))
        await observe(parts)
        assert parts.metrics.registry.get_sample_value("roadgrip_interval_at_least", {"section": "long-turn"}) == 1
        await parts.unit.close()

    asyncio.run(scenario())


def test_each_section_has_its_own_winter_speed(folder):
    async def scenario() -> None:
        sections = '[[sections]]\nfile = "s-turn"\nwinter_speed_mps = 11.2\n[[sections]]\nfile = "long-turn"\n'
        parts = parts_of(folder, sections)
        advised = {}
        for section_id in ("s-turn", "long-turn"):
            advisory = parts.unit.current_advisory(section_id)
            assert isinstance(advisory, Advisory)
            advised[section_id] = round(advisory.speed_mps * 3.6)
        assert advised == {"s-turn": 40, "long-turn": 60}
        await parts.unit.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("enabled", [False, True])
def test_changes_are_looked_for_where_that_is_chosen(folder, enabled):
    async def scenario() -> None:
        parts = parts_of(folder, f"[change_detection]\nenabled = {str(enabled).lower()}\n")
        (section, *_) = load_sections(parts.settings)
        for seed in range(42):
            mu = 0.6 if seed < 30 else 0.25
            await parts.unit.ingest_passage(make_passage(section, seed=seed, mu=mu, age_s=500.0 - 10.0 * seed))
        interval = parts.unit.current_interval(section.section_id)
        assert isinstance(interval, FrictionInterval)
        assert interval.passages_count == (12 if enabled else 42)
        await parts.unit.close()

    asyncio.run(scenario())


CHOSEN = """
[window]
provisional_from_count = 3
recommended_from_count = 4
stale_after_s = 500.0
valid_at_most_s = 50.0
[probing]
evidence_count = 25
likely_count = 30
[change_detection]
enabled = true
lag_count = 9
[advisory]
winter_speed_mps = 12.0
utilisation_frac = 0.5
rise_margin_mps = 0.25
valid_for_s = 200.0
"""


def test_what_is_chosen_reaches_the_unit(folder):
    async def scenario() -> None:
        unit = parts_of(folder, CHOSEN).unit
        assert unit._friction_policies == FrictionPolicies(  # noqa: SLF001 - what follows is the domain's to test
            interval=IntervalPolicy(
                provisional_from_count=3, recommended_from_count=4, stale_after_s=500.0, valid_at_most_s=50.0
            ),
            probing=ProbingPolicy(evidence_count=25, likely_count=30),
            change=ChangePolicy(lag_count=9),
        )
        (state,) = unit._states.values()  # noqa: SLF001 - same
        assert state.policy == AdvisoryPolicy(
            winter_speed_mps=12.0, utilisation_frac=0.5, rise_margin_mps=0.25, valid_for_s=200.0
        )
        await unit.close()

    asyncio.run(scenario())


def test_a_section_given_twice_is_refused(folder):
    with pytest.raises(ConfigurationError, match="twice"):
        parts_of(folder, '[[sections]]\nfile = "s-turn"\n[[sections]]\nfile = "s-turn"\n')


def test_a_map_that_does_not_fit_the_air_is_refused_at_the_start():
    x_m = np.arange(1000) * 9.0
    section = build_section(
        section_id="long",
        name="Too long",
        nodes_m=np.column_stack([x_m, 50.0 * np.sin(x_m / 300.0), 10.0 * np.sin(x_m / 100.0)]),
        speed_limit_mps=20.0,
        anchors=[GnssAnchor(float(station_m), 60.0, 10.0) for station_m in range(0, 8900, 45)],
    )
    with pytest.raises(ConfigurationError, match="section long"):
        check_maps((section,), signer=None)


SIGNING = """
[signing]
credential_file = "unit.pem"
authorities_folder = "authorities"
revocations_file = "revoked.cose"

[udp]
signatures = "required"
"""


def public_pem_of(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def write_revocations(folder, *, issued_unix_s: int, ids: frozenset[bytes] = frozenset()) -> None:
    revoked = RevocationList(issued_unix_s, 2**40, ids)
    (folder / "revoked.cose").write_bytes(issue_revocations(revoked, authority=AUTHORITY_KEY))


@pytest.fixture
def signing_settings(folder):
    (folder / "unit.pem").write_bytes(credential_to_pem(UNIT))
    (folder / "authorities").mkdir()
    (folder / "authorities" / "of-the-road.pem").write_bytes(public_pem_of(AUTHORITY_KEY))
    write_revocations(folder, issued_unix_s=1000, ids=frozenset({b"stolen!!"}))
    config = folder / "keys.toml"
    config.write_text(SIGNING, encoding="utf-8")
    return load_settings(config)


def test_trust_is_read_from_its_files(signing_settings):
    trust = load_trust(signing_settings)
    assert trust.signer is not None
    assert trust.signer.certificate == UNIT.certificate
    assert trust.verifier is not None
    assert trust.verifier.authorities.keys() == AUTHORITIES.keys()
    assert trust.revocations is not None
    assert trust.revocations.certificate_ids == {b"stolen!!"}


def test_trust_stays_the_same_while_no_file_changes(signing_settings):
    trust = load_trust(signing_settings)
    assert load_trust(signing_settings, previous=trust) is trust


def test_a_rotation_needs_no_restart(signing_settings, folder):
    before = load_trust(signing_settings)
    (folder / "authorities" / "next.pem").write_bytes(public_pem_of(OTHER_AUTHORITY_KEY))
    renewed = signer_of(Role.UNIT, certificate_id=b"renewed.", authority=OTHER_AUTHORITY_KEY)
    (folder / "unit.pem").write_bytes(credential_to_pem(renewed))
    after = load_trust(signing_settings, previous=before)
    assert after.signer is not None
    assert after.signer.certificate == renewed.certificate
    assert after.verifier is not None
    assert len(after.verifier.authorities) == 2


def test_a_list_issued_earlier_never_replaces_a_later_one(signing_settings, folder):
    before = load_trust(signing_settings)
    write_revocations(folder, issued_unix_s=999)
    after = load_trust(signing_settings, previous=before)
    assert after.revocations == before.revocations
    assert after.older_list_ignored
    write_revocations(folder, issued_unix_s=1001)
    assert load_trust(signing_settings, previous=after).revocations == RevocationList(1001, 2**40, frozenset())


def test_a_file_of_something_else_is_named(signing_settings, folder):
    (folder / "authorities" / "damaged.pem").write_bytes(b"not a key")
    with pytest.raises(ConfigurationError, match=r"damaged\.pem: not a public key"):
        load_trust(signing_settings)


def test_signatures_cannot_be_asked_for_where_no_authority_is_trusted(signing_settings, folder):
    (folder / "authorities" / "of-the-road.pem").unlink()
    with pytest.raises(ConfigurationError, match=r"udp\.signatures needs"):
        load_trust(signing_settings)


def test_trust_is_renewed_while_the_unit_runs_and_files_that_cannot_be_used_change_nothing(folder):
    async def scenario() -> None:
        credential = folder / "unit.pem"
        credential.write_bytes(credential_to_pem(UNIT))
        parts = parts_of(folder, f'[signing]\ncredential_file = "{credential}"\n')
        before = parts.signatures.trust
        renew_trust(parts)
        assert parts.signatures.trust is before
        credential.write_bytes(b"rubbish")
        renew_trust(parts)
        assert parts.signatures.trust is before
        credential.write_bytes(credential_to_pem(signer_of(Role.UNIT, certificate_id=b"another!")))
        renew_trust(parts)
        assert parts.signatures.trust.signer != before.signer
        await parts.unit.close()

    asyncio.run(scenario())
