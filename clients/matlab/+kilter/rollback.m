function document = rollback(robot)
% ROLLBACK  Return to the version that was active before.
document = kilter.internal.send(['/v1/robots/' kilter.internal.quote(robot) '/rollback']);
end
