function document = activate(id, reason)
% ACTIVATE  Correct the robot with this version from now on, unless it predicts worse than the active one.
%   kilter.activate(id, 'the arm was repaired') activates it all the same; the log keeps the reason.
body = struct('force', nargin > 1);
if nargin > 1
    body.reason = reason;
end
document = kilter.internal.send(['/v1/versions/' kilter.internal.quote(id) '/activate'], body);
end
