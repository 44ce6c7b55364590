function document = activate(id)
% ACTIVATE  Correct the robot with this version from now on.
document = kilter.internal.send(['/v1/versions/' kilter.internal.quote(id) '/activate']);
end
