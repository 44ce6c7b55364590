"""Signed frames: only what the holder of a session's key sent now, and once, is corrected.

``tools.lab attack-stream`` sends a million damaged, forged, replayed and reordered frames; the usual tests send fewer.
"""

from __future__ import annotations

import json
import random
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest

from kilter_client.signing import Session, Signer
from kilter_core.model import Calibration
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.slots import Address, Admitted, Gate, Guard
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Flag, Status
from kilter_service.stream.signing.masters import Master, Masters
from tests.corrector import sealer

SECRET = bytes(range(32))
ADDRESS = Address("test", "katana450-chapter4", "main")
Q = (0.1, 0.6, 0.4, 0.3, 0.2)
MS = 1_000_000


@pytest.fixture(scope="module")
def active(katana: Calibration, active_of: Callable[..., Active]) -> Active:
    return active_of(katana)


class Controller:
    """A controller with a session, and the corrector's side of its stream."""

    def __init__(self, active: Active, lifetime_s: int = 3600, gate: Gate | None = None, number: int = 1) -> None:
        self.active = active
        self.gate = gate or Gate(Masters((Master(SECRET),)))
        self.guard = Guard(self.gate, ADDRESS, Stream())
        self.session = sealer.session_id(SECRET, int(time.time()) + lifetime_s, number)
        self.key = sealer.session_key(SECRET, self.session, *ADDRESS)
        self.in_use = b""
        self.seq = 1000
        self.now = time.monotonic_ns()

    def greet(self) -> None:
        challenge = self.ask(sealer.greeting(self.session, self.key, 5))
        assert challenge is not None
        assert sealer.tag(self.key, "KLT2chal", challenge[:-16]) == challenge[-16:]
        self.in_use = sealer.derive(self.key, "KLT2work", sealer.nonce_of(challenge))

    def frame(self, flags: int = 0, seq: int | None = None, key: bytes | None = None) -> bytes:
        """The next setpoint, or one of another sequence number."""
        if seq is None:
            self.seq += 1
            self.now += MS
        head = struct.pack("<4sBBHQQQ", b"KLT2", 0, 5, flags, self.seq if seq is None else seq, self.now, self.now)
        return sealer.seal(head + struct.pack("<5d", *Q), self.session, key or self.in_use, "KLT2in")

    def ask(self, data: bytes) -> bytes | None:
        return self.guard.answer(data, self.now, self.active)

    def status(self, data: bytes) -> Status:
        """The verdict, whose signature is checked."""
        answer = self.ask(data)
        assert answer is not None
        assert sealer.tag(self.in_use, "KLT2out", answer[:-16]) == answer[-16:]
        assert answer[-32:-16] == self.session
        return wire.decode_answer(b"KLT1" + answer[4:-32]).status

    def began(self) -> Controller:
        self.greet()
        assert self.status(self.frame(Flag.RESET | Flag.SETTLED)) == Status.OK
        return self


def good(answer: bytes | None) -> bool:
    """Whether an answer contains corrected joints."""
    return answer is not None and len(answer) > 48 and struct.unpack_from("<H", answer, 44) == (0,)


def test_a_signed_setpoint_is_answered_as_a_plain_one(active: Active) -> None:
    controller = Controller(active).began()
    plain = Stream()
    for k in range(50):
        data = controller.frame(0 if k else Flag.RESET | Flag.SETTLED)
        signed = controller.ask(data)
        direct = plain.answer(b"KLT1" + data[4:-32], controller.now, active)
        assert signed is not None
        assert direct is not None
        numbers = np.frombuffer(signed[56:-32]), np.frombuffer(direct[56:])
        assert np.abs(numbers[0] - numbers[1]).max() < 1e-12


def test_a_session_key_alone_corrects_nothing(active: Active) -> None:
    controller = Controller(active)
    answer = controller.ask(controller.frame(key=controller.key))
    assert answer is not None
    assert sealer.nonce_of(answer)
    assert controller.guard.stream.good == 0


def test_replayed_and_reordered_frames_are_refused(active: Active) -> None:
    controller = Controller(active).began()
    frames = [controller.frame() for _ in range(20)]
    assert all(controller.status(data) == Status.OK for data in frames)
    assert {controller.status(data) for data in frames} == {Status.SEQ_BACK}
    reset = controller.frame(Flag.RESET | Flag.SETTLED, seq=controller.seq - 5)
    assert controller.status(reset) == Status.SEQ_BACK  # a RESET of an old number is as old
    assert controller.status(controller.frame()) == Status.OK
    late, early = controller.frame(), controller.frame()
    assert controller.status(early) == Status.SEQ_GAP
    assert controller.status(late) == Status.SEQ_BACK
    assert controller.status(controller.frame()) == Status.OK


def test_what_was_recorded_before_a_restart_is_of_no_use(active: Active) -> None:
    before = Controller(active).began()
    recorded = [before.frame() for _ in range(20)]
    after = Controller(active)
    after.session, after.key = before.session, before.key
    assert not any(good(after.ask(data)) for data in recorded)
    after.began()
    assert not any(good(after.ask(data)) for data in recorded)
    assert after.status(after.frame()) == Status.OK


def test_a_session_that_was_replaced_does_not_come_back(active: Active) -> None:
    first = Controller(active, number=1).began()
    recorded = [first.frame() for _ in range(20)]
    assert all(first.status(data) == Status.OK for data in recorded)
    second = Controller(active, number=2, gate=first.gate)
    second.guard, second.seq, second.now = first.guard, first.seq, first.now
    second.greet()
    assert second.status(second.frame()) == Status.OK  # the sequence goes on
    assert not any(good(first.ask(data)) for data in recorded)
    assert second.status(second.frame()) == Status.OK


def test_a_controller_that_was_restarted_begins_with_the_same_session(active: Active) -> None:
    controller = Controller(active).began()
    recorded = [controller.frame() for _ in range(5)]
    controller.seq = 10  # less than before
    controller.began()
    assert not any(good(controller.ask(data)) for data in recorded)


def test_a_frame_of_another_stream_is_refused(active: Active) -> None:
    controller = Controller(active).began()
    other = Guard(controller.gate, ADDRESS._replace(stream="other"), Stream())
    assert not good(other.answer(controller.frame(), controller.now, active))
    assert other.stream.good == 0


def test_a_forged_copy_of_a_setpoint_gets_no_answer(active: Active) -> None:
    """An answer would be an echo of the setpoint with a refusal, signed by the corrector."""
    controller = Controller(active).began()
    copy = controller.frame()[:-16] + bytes(16)
    assert controller.ask(copy) is None


def test_an_expired_session_is_refused_with_a_signature(active: Active) -> None:
    controller = Controller(active).began()
    controller.now += 3_601_000 * MS
    assert controller.status(controller.frame()) == Status.SESSION_EXPIRED
    old = Controller(active, lifetime_s=-1)
    answer = old.ask(old.frame(key=old.key))
    assert answer is not None
    assert sealer.tag(old.key, "KLT2chal", answer[:-16]) == answer[-16:]
    assert struct.unpack_from("<H", answer, 44) == (Status.SESSION_EXPIRED,)


def test_the_master_before_the_one_in_use_is_valid_for_the_stated_time(active: Active) -> None:
    masters = Masters((Master(SECRET),)).with_rotated_secret(3600.0)
    Controller(active, gate=Gate(masters)).began()
    ended = Masters((Master(SECRET, time.time() - 1.0), masters.all[-1]))
    controller = Controller(active, gate=Gate(ended))
    assert controller.ask(sealer.greeting(controller.session, controller.key, 5)) is None


def test_plain_frames_are_refused_where_frames_are_signed(active: Active) -> None:
    controller = Controller(active).began()
    plain = b"KLT1" + controller.frame()[4:-32]
    answer = controller.ask(plain)
    assert answer is not None
    assert wire.decode_answer(answer).status == Status.UNSIGNED
    strict = Guard(Gate(Masters((Master(SECRET),)), unsigned=False), ADDRESS, Stream())
    answer = strict.answer(plain, controller.now, active)
    assert answer is not None
    assert wire.decode_answer(answer).status == Status.UNSIGNED
    assert strict.stream.good == 0


def test_forget_makes_earlier_nonces_useless() -> None:
    gate = Gate(Masters((Master(SECRET),)))
    session = sealer.session_id(SECRET, int(time.time()) + 60, 1)
    key = sealer.session_key(SECRET, session, *ADDRESS)
    challenge = gate.admit(ADDRESS, sealer.greeting(session, key, 5))
    assert isinstance(challenge, bytes)
    in_use = sealer.derive(key, "KLT2work", sealer.nonce_of(challenge))
    head = struct.pack("<4sBBHQQQ", b"KLT2", 0, 5, 0, 1, 2, 3) + struct.pack("<5d", *Q)
    data = sealer.seal(head, session, in_use, "KLT2in")
    assert isinstance(gate.admit(ADDRESS, data), Admitted)
    gate.forget()
    assert not isinstance(gate.admit(ADDRESS, data), Admitted)


@pytest.mark.parametrize("count", [20_000, pytest.param(500_000, marks=pytest.mark.slow)])
@pytest.mark.timeout(3600)
def test_no_attacked_frame_is_accepted(active: Active, count: int) -> None:
    """Damaged, forged, replayed, reordered frames and frames of other sessions, between good ones."""
    rng = random.Random(count)
    controller = Controller(active).began()
    earlier = [controller.frame() for _ in range(50)]
    controller.began()
    stranger = Controller(active, number=7)
    stranger.in_use = rng.randbytes(32)
    recent = [controller.frame() for _ in range(50)]
    assert all(good(controller.ask(data)) for data in recent)
    accepted = corrected = 0
    for k in range(count):
        what = k % 5
        if what == 0:
            data = sealer.damaged(controller.frame(seq=controller.seq + 1), rng)
        elif what == 1:
            data = rng.choice(earlier if rng.random() < 0.5 else recent)
        elif what == 2:
            data = stranger.frame()
        elif what == 3:
            data = controller.frame(seq=controller.seq - rng.randrange(1000), flags=rng.choice((0, 8, 24)))
        else:
            data = controller.frame(key=rng.choice((controller.key, SECRET)), seq=controller.seq + 1)
        accepted += good(controller.ask(data))
        if k % 100 == 0:
            corrected += controller.status(controller.frame()) == Status.OK
    assert accepted == 0
    assert corrected == -(-count // 100)
    print(f"{count} attacked frames: {accepted} accepted")


@pytest.mark.parametrize("count", [20_000, pytest.param(500_000, marks=pytest.mark.slow)])
@pytest.mark.timeout(3600)
def test_no_attacked_answer_or_document_is_accepted(count: int) -> None:
    """What a controller takes: answers, nonces, announcements and replies, all damaged or of another moment."""
    rng = random.Random(count)
    session = sealer.session_id(SECRET, int(time.time()) + 3600, 3)
    key = sealer.session_key(SECRET, session, *ADDRESS)
    robot_key = sealer.derive(SECRET, "KLT2robt", f"{ADDRESS.site}\0{ADDRESS.robot}".encode())
    signer = Signer(Session(session, key, robot_key))
    greeted = signer.greeting()
    challenge_head = struct.pack("<4sBBH", b"KLT2", 3, 0, 0) + greeted[8:32] + struct.pack("<QIHHIi", 0, 0, 12, 0, 0, 0)
    challenge = sealer.seal(challenge_head + bytes(16), session, key, "KLT2chal")
    for _ in range(200):
        assert signer.accept_challenge(sealer.damaged(challenge, rng), b"") is None
    assert signer.accept_challenge(challenge, b"") == 12
    assert signer.accept_challenge(challenge, b"") is None  # once only
    in_use = sealer.derive(key, "KLT2work", bytes(16))
    plain = struct.pack("<4sBBHQQQQIHHIi5d", b"KLT1", 0, 5, 0, 1, 2, 3, 9, 1, 0, 0, 1000, 0, *Q)
    answer = sealer.seal(plain, session, in_use, "KLT2out")
    assert signer.verify_answer(answer) == plain
    address, body = "kilter/@v1/test/arm/active", json.dumps({"epoch": 3, "version": "0" * 16}).encode()
    number = f"{struct.unpack_from('<I', session)[0]:08x}"

    def signed(tag: bytes, prefix: str = "") -> bytes:
        return body[:-1] + b', "signature": "' + prefix.encode() + tag.hex().encode() + b'"}'

    announced = signed(sealer.tag(robot_key, "KLT2said", address.encode() + b"\0" + body), f"{number}:")
    assert signer.verify_announcement(address, announced) == body
    question = signer.question()
    reply = signed(sealer.tag(key, "KLT2rply", question[-16:] + address.encode() + b"\0" + body))
    assert signer.verify_reply(question, address, reply) == body
    accepted = 0
    for k in range(count // 4):
        accepted += signer.verify_answer(sealer.damaged(answer, rng)) is not None
        wrong = sealer.seal(plain, session, rng.choice((key, rng.randbytes(32))), rng.choice(("KLT2out", "KLT2in")))
        accepted += signer.verify_answer(wrong) is not None
        accepted += (
            signer.verify_announcement(
                f"{address}{k % 2 or ''}", sealer.damaged(announced, rng) if k % 2 == 0 else announced
            )
            is not None
        )
        other = signer.question()
        accepted += signer.verify_reply(other, address, reply if k % 2 else sealer.damaged(reply, rng)) is not None
    assert accepted == 0
    print(f"{count} attacked answers and documents: {accepted} accepted")


def test_a_session_that_is_revoked_while_it_is_admitted_is_not_taken(active: Active) -> None:
    controller = Controller(active).began()
    controller.gate.masters = controller.gate.masters.with_sessions_revoked([controller.session])
    controller.guard.follow()
    assert controller.status(controller.frame()) == Status.SESSION_EXPIRED
    late = Controller(active)
    late.greet()
    admitted = late.gate.admit(ADDRESS, late.frame(Flag.RESET | Flag.SETTLED), b"", late.guard._secret)
    assert isinstance(admitted, Admitted)
    late.gate.masters = late.gate.masters.with_sessions_revoked([late.session])
    late.guard.adopt(admitted)
    assert late.status(late.frame(Flag.RESET | Flag.SETTLED)) == Status.SESSION_EXPIRED
