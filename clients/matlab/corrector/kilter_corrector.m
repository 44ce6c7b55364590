classdef kilter_corrector < handle
%KILTER_CORRECTOR  The corrector in C, in this process: no server, no network.
%   c = kilter_corrector('arm.klt') takes what `kilter version export VERSION --format corrector` writes. The arm rests at the
%   first setpoint; c = kilter_corrector('arm.klt', false) ramps the correction in instead.
%   [q, status, flags, left_m] = c.step(wanted, dt)   one setpoint of a stream, rad (prismatic joints: m), dt in s
%   [q, status, flags, left_m] = c.alone(wanted)      one that follows no other
%   q is NaN unless status is 0. Statuses and flags are those of kilter_corrector.h.
%   There is one corrector in a process: another object replaces it. Build: see README.md.
  methods
    function self = kilter_corrector(file, settled)
      if nargin < 2
        settled = true;
      end
      id = fopen(file, 'r');
      if id < 0
        error('kilter:file', '%s: cannot be read.', file);
      end
      bytes = fread(id, Inf, '*uint8');
      fclose(id);
      kilter_corrector_mex('load', bytes, settled);
    end
    function [q, status, flags, left_m] = step(self, wanted, dt)
      [q, status, flags, left_m] = kilter_corrector_mex('step', wanted, dt);
    end
    function [q, status, flags, left_m] = alone(self, wanted)
      [q, status, flags, left_m] = kilter_corrector_mex('alone', wanted);
    end
    function restart(self, settled)
      kilter_corrector_mex('restart', settled);
    end
  end
end
