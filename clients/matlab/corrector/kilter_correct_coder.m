function [q, status] = kilter_correct_coder(wanted, dt) %#codegen
%KILTER_CORRECT_CODER  One setpoint corrected, for MATLAB Coder and Simulink: a MATLAB Function block calls it.
%   [q, status] = kilter_correct_coder(wanted, dt): rad (prismatic joints: m) and s; q is NaN unless status is 0.
%   The code that is generated calls the C file that `kilter version export VERSION --format c` writes, in which the program is
%   a constant (kc_program): nothing is read and nothing allocated. Build with it: see README.md.
%   In MATLAB and Octave themselves use kilter_corrector.m.
  coder.cinclude('kilter_coder.h');
  coder.updateBuildInfo('addSourceFiles', 'kilter_coder.c');
  q = nan(size(wanted));
  status = int32(0);
  status = coder.ceval('kilter_coder_step', coder.rref(wanted), int32(numel(wanted)), dt, coder.wref(q));
end
