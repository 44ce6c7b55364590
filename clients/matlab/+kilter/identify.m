function job = identify(robot, campaigns, varargin)
% IDENTIFY  Identify a robot's parameters and make a version; waits for the end.
%   job = kilter.identify('arm', campaign, 'level', 1, 'validation', 0.3)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
%     effects              Effects to identify, by id or with options; left out: none, at level 3 the thesis's three.
%     free                 Parameters to identify, by name or pattern (alpha_*); left out: those of the level.
%     fix                  Parameters to hold, by name or pattern (alpha_*).
%     refit                ["base"]: every campaign and session has a base of its own; ["tool"]: a tool (a remounted
%                          marker); []: all rows share one of each; left out: the device decides, and sheets and ball
%                          bars have bases of their own.
%     sheet_order          given: the quarter points of drawn sheets are in the right order, do not check; left out:
%                          checked.
%     start                Id of the version to start from; left out: the nominal robot.
%     masses_from          Id of a search in torques of this robot, or newest: masses and centres of links, and
%                          friction of joints, are what it found, as surely as it knows them; left out: as the robot
%                          is described.
%     limits               The largest correction the version may make; left out: what it needs at 99 % of its poses,
%                          from 1 degree and 5 mm to 5 degrees and 10 mm.
%     socket_distances_mm  Known distances between ball sockets, mm, above 0: {"1-2": 400.0}.
%     level                1 joint offsets, 2 geometry, 3 geometry and effects; left out: 3 when effects are named,
%                          else 2.
%     method               The estimator.
%     tilt_first           Hold the effects while the geometry is identified: those of the start, else as fitted
%                          before it.
%     base                 Whether the base is fitted; removed: only distances between poses count.
%     tool                 Whether the tool is fitted.
%     loss                 huber bounds what a wrong row can pull, tukey sets it aside and names it.
%     noise_mm             Standard deviation of a coordinate, mm, above 0; left out: estimated from the rows.
%     reference            Frames that corrections work in: the robot's own, those of the registration, or auto: the
%                          robot's own for a frame that is fixed or found within 10 mm and 1 degree of it.
%     seed                 Seed of everything that is drawn by chance, 0 or more.
%     search_mm            Half the width of a global search in lengths, mm, above 0.
%     search_deg           Half the width of a global search in angles, degrees, above 0.
%     intervals            Add 95 % intervals that do not rest on the covariance; left out: none.
%     masses               uncertain: errors of masses and centres are carried beside effects that follow the load,
%                          as load_error does; as_stated: masses are exact; auto: uncertain, but beside an effect
%                          that follows the sign of a load values are fitted with masses as stated, and sigmas hold
%                          what their errors do.
%     mass_sigma_percent   Standard deviation of every mass, percent of it, above 0; left out: what the robot says of
%                          each.
%     com_sigma_mm         Standard deviation of each coordinate of every centre of mass, mm, above 0; left out: what
%                          the robot says.
%     prior                fleet: add what versions of at least five other robots of this type say before the rows;
%                          left out: none of them is asked.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('identify', robot, campaigns, options, validation);
end
