"""The MATLAB client in GNU Octave, against a running server: the whole way of a calibration."""

from __future__ import annotations

import csv
import io
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_files.tables.table import CSV_TYPE, Prepared
from kilter_service.robots.exporters.registry import export
from tests.blind.generator import Case, Hidden, Options, generate
from tests.clients.test_gap_command import campaign
from tests.service.exporters.test_exporters import ERRORS, calibrated, poses_of

OCTAVE = shutil.which("octave-cli")
CLIENT = Path(__file__).resolve().parents[2] / "clients" / "matlab"

pytestmark = pytest.mark.skipif(OCTAVE is None, reason="octave-cli is not installed (Debian: apt-get install octave)")


def octave(script: str, folder: Path, code: int = 0) -> str:
    """Run a script and return what it printed."""
    assert OCTAVE
    file = folder / "script.m"
    file.write_text(f"addpath('{CLIENT}');\n{script}\n")
    done = subprocess.run(
        [OCTAVE, "--no-gui", "--quiet", "--norc", str(file)],
        cwd=folder, env=os.environ | {"HOME": str(folder)}, capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    assert "shadows a built-in" not in done.stderr
    return done.stdout


def test_from_upload_to_corrected_joints(kilter: Kilter, robot: str, write_campaign: Any, tmp_path: Path) -> None:
    write_campaign(poses=40)
    name = robot + "-m"
    printed = octave(
        f"""
        r = kilter.robot_add(struct('name', '{name}', 'convention', 'preset', 'preset', 'katana450-chapter4'));
        assert(numel(r.joints) == 5);
        u = kilter.upload('{name}', 'measured.csv', 'device', 'twin');
        again = kilter.upload('{name}', 'measured.csv', 'campaign', u.campaign_id);
        assert(strcmp(u.sha256, again.sha256) && u.rows == 40);
        job = kilter.identify('{name}', u.campaign_id, 'level', 1, 'validation', 0.3);
        before = job.result.metrics.validation.nominal.mean_mm;
        after = job.result.metrics.validation.identified.mean_mm;
        assert(after < before / 5);
        id = job.result.version_id;
        kilter.activate(id);
        q = [10 30 20 -10 5; 12 31 22 -9 4];
        [fixed, info] = kilter.correct('{name}', q, 't_s', [0; 0.01]);
        assert(all(strcmp(info.status, 'OK')));
        one = kilter.correct('{name}', q(1, :), 'version', id);
        printf('%.15g ', fixed, one, info.error_mm); printf('\\n%s\\n', id);
        v = kilter.versions('{name}');
        assert(v(1).active && strcmp(v(1).id, id));
        text = kilter.export(id, 'dh-csv', 'out.csv');
        assert(strcmp(text, fileread('out.csv')) && ~isempty(strfind(text, 'theta_offset_deg')));
        """,
        tmp_path,
    )
    numbers = [float(text) for text in printed.splitlines()[0].split()]
    trajectory = b"t_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n0,10,30,20,-10,5\n0.01,12,31,22,-9,4\n"
    rows = list(csv.DictReader(io.StringIO(kilter.correct(name, Prepared(trajectory, CSV_TYPE)).decode())))
    wanted = np.array([[float(row[f"q{j}_deg"]) for j in range(1, 6)] for row in rows])
    assert np.abs(np.array(numbers[:10]).reshape(5, 2).T - wanted).max() < 1e-12
    assert np.abs(np.array(numbers[10:15]) - wanted[0]).max() < 1e-9
    assert np.abs(wanted - [[10, 30, 20, -10, 5], [12, 31, 22, -9, 4]]).max() > 1e-3
    error = np.array([[float(row[f"d{axis}_mm"]) for axis in "xyz"] for row in rows])
    assert np.abs(np.array(numbers[15:]).reshape(3, 2).T - error).max() < 1e-9


def test_refusals_are_errors_with_the_servers_code(server: Path, robot: str, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,x_mm,y_mm,z_mm\n1,30,2,3,4,nan,1,2\n")
    printed = octave(
        f"""
        function tell(f)
          try
            f();
            disp('no error');
          catch found
            printf('%s | %s\\n', found.identifier, found.message);
          end
        end
        tell(@() kilter.robot('nobody here'));
        tell(@() kilter.upload('{robot}', 'bad.csv'));
        tell(@() kilter.upload('{robot}', 'missing.csv'));
        tell(@() kilter.correct('{robot}', [1 30 3 4 5]));
        tell(@() kilter.identify('{robot}', 'cmp_none'));
        setenv('KILTER_URL', 'http://127.0.0.1:9');
        tell(@() kilter.health());
        """,
        tmp_path,
    )
    lines = printed.splitlines()
    assert [line.split(" | ")[0] for line in lines] == [
        "kilter:robot_not_found", "kilter:observations_invalid", "kilter:file_invalid", "kilter:no_active_version",
        "kilter:campaign_not_found", "kilter:server_unreachable",
    ]  # fmt: skip
    assert "'nobody here'" in lines[0]
    assert "x_mm" in lines[1]


def test_a_gap_hunt_and_what_belongs_to_it(kilter: Kilter, tmp_path: Path) -> None:
    """Play was put into joint 1; Octave names it, evaluates the version, and plans what to measure next."""
    case = Case("m", "katana", (Hidden("backlash", (0,)),), (900.0,), 45, Options(temperature="constant"), "named", 5)
    rows = campaign(kilter, generate(case), "gap-octave", tmp_path)
    printed = octave(
        f"""
        job = kilter.gap('gap-octave', '{rows}', 'validation', 0.25, 'resamples', 20, 'bootstraps', 499, ...
          'effects', {{'backlash', 'friction_windup', 'eccentricity', 'encoder_scale', 'thermal_growth'}});
        printf('%s\\n', job.result.verdict);
        names = '';
        for k = 1:numel(job.result.effects)
          if iscell(job.result.effects), e = job.result.effects{{k}}; else, e = job.result.effects(k); end
          names = [names ' ' e.id];
        end
        printf('%s\\n', strtrim(names));
        printf('%g %g\\n', job.result.gap.validation_before_mm, job.result.gap.validation_after_mm);
        e = kilter.evaluate('gap-octave', '{rows}', 'version', job.result.version_id);
        printf('%s\\n', e.state);
        p = kilter.plan('gap-octave', {{}}, 'purpose', 'identify', 'count', 6);
        printf('%d\\n', numel(p.result.poses));
        """,
        tmp_path,
    ).splitlines()
    assert printed[0] == "closed"
    assert "backlash" in printed[1].split()
    before, after = map(float, printed[2].split())
    assert after < 0.8 * before  # what is left is noise
    assert printed[3:] == ["succeeded", "6"]


def test_the_exported_function_builds_the_arm(tmp_path: Path) -> None:
    """Octave has no rigidBodyTree: stand-ins written here collect what the function says, and multiply it out."""
    file, calibration = calibrated(ERRORS, tool={"z_mm": 100.0})
    written = export("matlab", file)
    (tmp_path / written.name).write_text(written.text)
    for name, body in STAND_INS.items():
        (tmp_path / f"{name}.m").write_text(body)
    q = [0.3, -0.5, 0.7, 0.2, -0.9, 1.1]
    printed = octave(
        f"""
        robot = {written.name[:-2]}();
        T = eye(4); q = {q}; k = 0;
        for n = 1:numel(robot.bodies)
          b = robot.bodies{{n}};
          T = T * b.Joint.T;
          if strcmp(b.Joint.kind, 'revolute')
            k = k + 1; c = cos(q(k)); s = sin(q(k));
            T = T * [c -s 0 0; s c 0 0; 0 0 1 0; 0 0 0 1];
          end
        end
        printf('%.17g ', T');
        """,
        tmp_path,
    )
    found = np.array([float(v) for v in printed.split()]).reshape(4, 4)
    assert np.abs(found - poses_of(calibration, np.array([q]))[0]).max() < 1e-9


STAND_INS = {
    "rigidBodyTree": """classdef rigidBodyTree < handle
      properties
        Gravity
        bodies = {};
      end
      methods
        function o = rigidBodyTree(varargin)
        end
        function addBody(o, b, parent)
          o.bodies{end + 1} = b;
        end
      end
    end
    """,
    "rigidBody": """classdef rigidBody < handle
      properties
        name
        Joint
      end
      methods
        function o = rigidBody(n)
          o.name = n;
        end
      end
    end
    """,
    "rigidBodyJoint": """classdef rigidBodyJoint < handle
      properties
        name
        kind
        T
        JointAxis
        PositionLimits
      end
      methods
        function o = rigidBodyJoint(n, k)
          o.name = n;
          o.kind = k;
        end
        function setFixedTransform(o, T)
          o.T = T;
        end
      end
    end
    """,
}
