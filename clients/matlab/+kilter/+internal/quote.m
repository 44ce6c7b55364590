function out = quote(name)
% QUOTE  A name as part of an address.
bytes = unicode2native(char(name), 'UTF-8');
out = '';
for k = 1:numel(bytes)
    c = char(bytes(k));
    if any(c == ['a':'z' 'A':'Z' '0':'9' '-_.~'])
        out = [out c]; %#ok<AGROW>
    else
        out = [out sprintf('%%%02X', bytes(k))]; %#ok<AGROW>
    end
end
end
