function job = identify(robot, campaigns, varargin)
% IDENTIFY  Identify a robot's parameters and make a version; waits for the end.
%   job = kilter.identify('arm', campaign, 'level', 1, 'validation', 0.3)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('identify', robot, campaigns, options, validation);
end
