function text = export(id, form, file)
% EXPORT  A version as text in the format of another tool; written to FILE when one is named.
%   kilter.export('ver_7c', 'matlab', 'my_arm.m'); formats: json, urdf, mjcf, usd, dh-csv, mdh-csv, ur-yaml, matlab, c,
%   torque-c.
path = ['/v1/versions/' kilter.internal.quote(id) '/export?format=' kilter.internal.quote(form)];
text = kilter.internal.request('GET', path);
if nargin > 2
    handle = fopen(file, 'w');
    if handle < 0
        error('kilter:file_invalid', '%s cannot be written.', file);
    end
    fwrite(handle, unicode2native(text, 'UTF-8'), 'uint8');
    fclose(handle);
end
end
