function job = plan(robot, campaigns, varargin)
% PLAN  Plan poses to measure; waits for the end. CAMPAIGNS may be {}.
%   job = kilter.plan('arm', {}, 'purpose', 'iso9283', 'count', 30)
%   Further pairs are the job's options. JOB.result holds the result; a job that fails is an error kilter:CODE.
%     purpose              iso9283: cube and planes of the standard; identify: poses that determine the parameters
%                          best; separate: poses that tell two effects apart; check: the few poses that best show
%                          whether the arm has moved.
%     method               Of identify: d_optimal, views (the same of what cameras see of boards, which version or
%                          campaigns know) or the poses of iso9283; of iso9283: five_poses or two_poses for its
%                          cycles.
%     count                Poses, 1 to 2000, or cycles; left out: 118, 60, 12 or 5 poses by purpose, 30 cycles.
%     effects              Of identify: effects to see; of separate: the two, or one to tell from geometry; left out:
%                          what the gap search that made the version left undecided.
%     seed                 Seed of the choice, 0 or more.
%     noise_mm             Standard deviation of a coordinate, or at the board of a corner that a camera sees, mm,
%                          above 0; left out: that of the repeats, else 0.05.
%     version              Id of the version to plan with; left out: the nominal robot.
%     box_mm               Lowest and highest corner, mm, of a box the tool stays in, in the frame of the
%                          measurements.
%     keep_out_mm          Lowest and highest corners, mm, of boxes that no line between joints and tool enters, in
%                          the frame of the measurements.
%     without_joints       Of check: joints, from 1, whose zeros need not be seen.
%     floor_mm             Height in the robot's base frame, mm, that no joint and no tool point goes below.
%     within               Where poses may be: where the robot was driven before, or anywhere in its limits.
%     prior                Of identify by d_optimal: fleet: add what versions of at least five other robots of this
%                          type say before the rows; left out: none of them is asked.
%     payloads_kg          Loads at hand, kg, 0 to 1000; used where an effect feels them.
%     payload_com_mm       Centre of these loads in the tool frame, mm; left out: the tool point.
[options, validation] = kilter.internal.options(varargin);
job = kilter.internal.run('plan', robot, campaigns, options, validation);
end
