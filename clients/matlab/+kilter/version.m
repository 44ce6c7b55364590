function document = version(id)
% VERSION  A version with all it holds.
document = kilter.internal.fetch(['/v1/versions/' kilter.internal.quote(id)]);
end
