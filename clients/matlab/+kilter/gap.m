function job = gap(robot, campaigns, varargin)
% GAP  Find and name what the model is missing; waits for the end.
%   job = kilter.gap('arm', {train, more}, 'alpha', 0.01)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
%     start                Id of the version to continue from; left out: the nominal robot.
%     effects              Look for these effects only, by id or at some joints; left out: for all.
%     free                 Parameters to identify, by name or pattern (alpha_*); left out: those of the level.
%     fix                  Parameters to hold, by name or pattern (alpha_*).
%     refit                ["tool"]: every campaign and session has a tool of its own (a remounted marker); []: all
%                          rows share one.
%     masses_from          Id of a search in torques of this robot, or newest: masses and centres of links, and
%                          friction of joints, are what it found, as surely as it knows them; left out: as the robot
%                          is described.
%     prior                fleet: add what versions of at least five other robots of this type say before the rows;
%                          left out: none of them is asked.
%     limits               The largest correction the version may make; left out: what it needs at 99 % of its poses,
%                          from 1 degree and 5 mm to 5 degrees and 10 mm.
%     alpha                Chance of any false name in the whole search, between 0 and 0.5.
%     noise_mm             Standard deviation of a coordinate, mm, above 0, where no pose was measured twice.
%     base                 Whether the base is fitted.
%     tool                 Whether the tool is fitted.
%     reference            Frames that corrections work in: the robot's own, those of the registration, or auto: the
%                          robot's own for a frame that is fixed or found within 10 mm and 1 degree of it.
%     max_effects          Most effects to name, 1 to 50; an effect at several joints is one.
%     bootstraps           Resamples behind the p-value of an effect, 1 to 20000.
%     resamples            Resamples of poses on which a name must return, 1 to 10000.
%     permutations         Shuffles of the negative control, 1 to 10000.
%     next_poses           Poses to propose, 0 to 1000.
%     seed                 Seed of everything that is drawn by chance, 0 or more.
%     matters_um           Movement of the tool below which nothing matters, micrometres (um), 0 or more.
%     budget_s             Seconds that a search may take, above 0: it then ends with the best it has; left out: as
%                          many as it needs.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('gap', robot, campaigns, options, validation);
end
