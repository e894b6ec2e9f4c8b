// The shaders. Space is normalised units relative to the eye, axes right, up, forward; so float32 is enough at any zoom.

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;
precision highp usampler2D;
precision highp usampler2DArray;
`;

const CAMERA = `
uniform sampler2D uSpheres;   // centre, radius
uniform vec3 uEyeHigh, uEyeLow; // two floats make a double, so that a close eye does not jump from float to float
uniform mat3 uBasis;          // columns right, up, forward
uniform vec2 uHalf;           // half extent of the picture: at distance 1, or anywhere if orthographic
uniform vec2 uSize;           // pixels
uniform vec2 uShift;          // where in its pixel a ray starts, from the centre, in pixels
uniform bool uOrthographic;

ivec2 place(int id, int width) { return ivec2(id % width, id / width); }

vec4 sphereAt(int id) {
  vec4 s = texelFetch(uSpheres, place(id, textureSize(uSpheres, 0).x), 0);
  return vec4(((s.xyz - uEyeHigh) - uEyeLow) * uBasis, s.w);
}

// Nearest front face of a sphere along the ray through pixel p (lower left corner is 0): distance, or -1.
// The distance counts along the view direction.
float hit(vec4 s, vec2 p, out vec3 origin, out vec3 ray) {
  vec2 plane = ((p + uShift) / uSize * 2.0 - 1.0) * uHalf;
  origin = uOrthographic ? vec3(plane, 0) : vec3(0);
  ray = uOrthographic ? vec3(0, 0, 1) : vec3(plane, 1);
  float dd = dot(ray, ray);
  vec3 to = s.xyz - origin;
  float b = dot(to, ray) / dd;
  vec3 off = to - b * ray; // from the ray to the centre; b*b - c would cancel for small far spheres
  float rest = s.w * s.w - dot(off, off);
  if (rest < 0.0) return -1.0;
  return b - sqrt(rest / dd);
}
`;

/** Four vertices a particle, the exact bounds of the sphere's picture. Not instanced: that is slow for so few vertices. */
export const IDS_VERTEX = HEAD + CAMERA + `
uniform usampler2D uList;
uniform bool uListed;
uniform int uFirst;
flat out vec4 vSphere;
flat out uint vId;

// Ends of a sphere's picture along one axis: where the two tangents from the eye meet the plane at distance 1.
// Behind the eye a tangent meets nothing; the picture then reaches to infinity, or is not there at all.
bool ends(float x, float z, float r, out vec2 range) {
  range = vec2(-1e9, 1e9);
  float dd = x * x + z * z;
  if (dd <= r * r) return true;
  float l = sqrt(dd - r * r);
  vec2 across = x * l + vec2(-z, z) * r, ahead = z * l + vec2(x, -x) * r;
  if (ahead.x > 0.0) range.x = across.x / ahead.x;
  else if (across.x > 0.0) return false;
  if (ahead.y > 0.0) range.y = across.y / ahead.y;
  else if (across.y < 0.0) return false;
  return true;
}

void main() {
  int id = uFirst + (gl_VertexID >> 2);
  if (uListed) id = int(texelFetch(uList, place(id, textureSize(uList, 0).x), 0).r);
  vec4 s = sphereAt(id);
  vSphere = s;
  vId = uint(id) + 1u;
  vec2 low, high;
  bool shown;
  if (uOrthographic) {
    shown = s.z + s.w > 0.0;
    low = s.xy - s.w;
    high = s.xy + s.w;
  } else {
    vec2 x, y;
    shown = s.z + s.w > 0.0 && dot(s.xyz, s.xyz) > s.w * s.w // from inside, a sphere shows no front face
      && ends(s.x, s.z, s.w, x) && ends(s.y, s.z, s.w, y);
    low = vec2(x.x, y.x);
    high = vec2(x.y, y.y);
  }
  vec2 pixel = 2.0 / uSize;
  low = low / uHalf - uShift * pixel - 0.02 * pixel; // the margin covers rounding
  high = high / uHalf - uShift * pixel + 0.02 * pixel;
  shown = shown && all(lessThan(low, vec2(1))) && all(greaterThan(high, vec2(-1)));
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1);
  gl_Position = shown ? vec4(mix(clamp(low, -1.0, 1.0), clamp(high, -1.0, 1.0), corner), 0, 1) : vec4(2, 2, 2, 1);
}`;

export const IDS_FRAGMENT = HEAD + CAMERA + `
flat in vec4 vSphere;
flat in uint vId;
uniform float uNear, uFar;
out uint outId;

void main() {
  vec3 origin, ray;
  float t = hit(vSphere, gl_FragCoord.xy, origin, ray);
  if (t <= 0.0) discard;
  // Reversed depth in a float buffer is as fine near as far, so there are no clip planes to fit.
  gl_FragDepth = uOrthographic ? 1.0 - t / uFar : min(1.0, uNear / t);
  outId = vId;
}`;

export const SCREEN_VERTEX = HEAD + `
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1);
}`;

export const LIGHTS_MAX = 8;

/** Luminance and colour of what the id buffer holds; sums of samples, tone comes later. */
export const SHADE_FRAGMENT = HEAD + CAMERA + `
uniform usampler2D uIds;
uniform sampler2D uValues;      // position in the colour map, or a packed colour; negative is no data
uniform sampler2D uLut;         // linear light
uniform isampler2D uSlots;      // slot + generation << 24, or -1
uniform usampler2DArray uAtlas; // tiles one after the other, 2048 bytes a row
uniform sampler2D uDecoding;    // a row of 256 luminances for each generation
uniform int uTexels, uMapping;  // mapping 0: latitude-longitude, 1: octahedral
uniform sampler2D uCoarse;      // first light; red < 0 where there is none
uniform float uCoarseScale;
uniform float uSpacing;         // of the picture's rays, in pixels
uniform bool uUseTiles, uUseCoarse, uUniform, uPacked;
uniform vec3 uColor, uNoData;   // linear light
uniform vec3 uEye;
uniform vec2 uSky;              // level, ground
uniform vec3 uSkyAxis;
uniform int uSunCount, uGlobeCount, uQuadCount;
uniform vec4 uSuns[2 * ${LIGHTS_MAX}];   // direction, level | sine of half the angular diameter
uniform vec4 uGlobes[2 * ${LIGHTS_MAX}]; // centre, radius | level
uniform vec4 uQuads[2 * ${LIGHTS_MAX}];  // centre, level | normal, area
layout(location = 0) out vec4 outSum;    // luminance times linear colour, luminance
layout(location = 1) out float outCover;

const float PI = 3.14159265358979;

float texel(int slot, int generation, ivec2 at) {
  int last = uTexels - 1;
  ivec2 inside = clamp(at, 0, last); // column, row
  // Beyond an edge, octahedral texels continue mirrored along it; latitude-longitude on the opposite side of a pole.
  bvec2 beyond = notEqual(at, inside);
  if (uMapping == 1) {
    inside = ivec2(beyond.y ? last - inside.x : inside.x, beyond.x ? last - inside.y : inside.y);
  } else {
    inside.x = (at.x + uTexels + (beyond.y ? uTexels / 2 : 0)) % uTexels;
  }
  int place = (slot * uTexels + inside.y) * uTexels + inside.x;
  uint code = texelFetch(uAtlas, ivec3(place & 2047, (place >> 11) & 2047, place >> 22), 0).r;
  return texelFetch(uDecoding, ivec2(int(code), generation), 0).r;
}

// Where a direction lies in the square of a texture; the same as luxel.kernels.mapping.texel_uv.
vec2 square(vec3 n) {
  vec3 a = abs(n);
  float quarters = max(a.x, a.y) > 0.0 ? atan(a.y, a.x) / (0.5 * PI) : 0.0; // of the azimuth, within its quadrant
  if (uMapping == 1) {
    float r = sqrt(dot(n.xy, n.xy) / (1.0 + a.z));
    vec2 p = r * vec2(1.0 - quarters, quarters);
    if (n.z < 0.0) p = 1.0 - p.yx;
    return 0.5 + 0.5 * vec2(n.x < 0.0 ? -p.x : p.x, n.y < 0.0 ? -p.y : p.y);
  }
  float u = 0.25 * (n.x < 0.0 ? 2.0 - quarters : quarters);
  return vec2(n.y < 0.0 ? 1.0 - u : u, atan(length(n.xy), n.z) / PI);
}

// Bilinear (paper 3.4).
float textured(int tile, vec3 n) {
  int slot = tile & 0xffffff, generation = tile >> 24;
  vec2 at = square(n) * float(uTexels) - 0.5;
  vec2 base = floor(at), f = at - base;
  ivec2 p = ivec2(base);
  return mix(
    mix(texel(slot, generation, p), texel(slot, generation, p + ivec2(1, 0)), f.x),
    mix(texel(slot, generation, p + ivec2(0, 1)), texel(slot, generation, p + ivec2(1, 1)), f.x), f.y);
}

// Mean over what a ray stands for, four points around its hit; the same as luxel.kernels.shade._filtered.
float filtered(int tile, float radius, vec3 n, float depth, vec3 ray) {
  float gap = uSpacing * 2.0 * uHalf.x / uSize.x * (uOrthographic ? 1.0 : depth) / radius;
  float reach = 0.25 * gap * clamp(gap / 0.2 - 1.0, 0.0, 1.0), sum = 0.0, count = 0.0;
  vec3 d = normalize(ray);
  vec3 a = vec3(1, 0, 0) - d.x * d, b = cross(a, d), q = n - dot(n, d) * d;
  for (int k = 0; reach > 0.0 && k < 4; k++) {
    vec3 p = q + ((k & 1) != 0 ? reach : -reach) * a + ((k & 2) != 0 ? reach : -reach) * b;
    float rest = 1.0 - dot(p, p);
    for (bool near = rest > 0.19; near; near = false) { // beyond, a pixel shows more of what lies behind
      sum += textured(tile, uBasis * (p - sqrt(rest) * d));
      count += 1.0;
    }
  }
  for (; count == 0.0; count = 1.0) sum = textured(tile, uBasis * n);
  return sum / count;
}

float soft(float c, float s) {
  return c >= s ? c : c <= -s ? 0.0 : (c + s) * (c + s) / (4.0 * s);
}

// Unshadowed direct light in closed form; the same as luxel.kernels.light.lambert.
float lambert(vec3 p, vec3 n) {
  float sum = uSky.y + (uSky.x - uSky.y) * 0.5 * (1.0 + 2.0 / 3.0 * dot(n, uSkyAxis));
  for (int k = 0; k < uSunCount; k++) {
    sum += uSuns[2 * k].w * soft(dot(n, uSuns[2 * k].xyz), uSuns[2 * k + 1].x);
  }
  for (int k = 0; k < uGlobeCount; k++) {
    vec4 g = uGlobes[2 * k];
    vec3 c = g.xyz - p;
    float d2 = dot(c, c), d = sqrt(d2);
    if (d2 > g.w * g.w) sum += uGlobes[2 * k + 1].x * g.w * g.w / d2 * soft(dot(n, c) / d, g.w / d);
  }
  for (int k = 0; k < uQuadCount; k++) {
    vec3 c = uQuads[2 * k].xyz - p;
    float d2 = max(dot(c, c), 1e-12), d = sqrt(d2);
    float facing = max(0.0, -dot(uQuads[2 * k + 1].xyz, c) / d);
    sum += uQuads[2 * k].w * max(0.0, dot(n, c) / d) * facing * uQuads[2 * k + 1].w / (PI * d2);
  }
  return sum;
}

vec3 colorOf(int id) {
  if (uUniform) return uColor;
  float x = texelFetch(uValues, place(id, textureSize(uValues, 0).x), 0).r;
  if (x < 0.0) return uNoData;
  if (uPacked) {
    vec3 c = vec3(ivec3(int(x)) >> ivec3(16, 8, 0) & 255) / 255.0;
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045)));
  }
  int rows = textureSize(uLut, 0).x;
  return texelFetch(uLut, ivec2(min(rows - 1, int(x * float(rows))), 0), 0).rgb;
}

void main() {
  uint found = texelFetch(uIds, ivec2(gl_FragCoord.xy), 0).r;
  vec4 sum = vec4(0);
  float cover = 0.0;
  // Loops of one turn, because processors that draw in software skip a loop that no pixel needs, but never a branch.
  for (bool turn = found != 0u; turn; turn = false) {
    int id = int(found) - 1;
    vec4 s = sphereAt(id);
    vec3 origin, ray;
    float t = hit(s, gl_FragCoord.xy, origin, ray);
    vec3 facing = normalize(origin + t * ray - s.xyz), n = uBasis * facing;
    int tile = uUseTiles ? texelFetch(uSlots, place(id, textureSize(uSlots, 0).x), 0).r : -1;
    float luminance = 0.0;
    for (bool lit = tile >= 0; lit; lit = false) luminance = filtered(tile, s.w, facing, t, ray);
    vec4 coarse = vec4(-1);
    for (bool dim = tile < 0 && uUseCoarse; dim; dim = false) {
      coarse = texelFetch(uCoarse, place(id, textureSize(uCoarse, 0).x), 0);
      luminance = uCoarseScale * max(0.0, coarse.x + dot(coarse.yzw, n));
    }
    for (bool bare = tile < 0 && coarse.x < 0.0; bare; bare = false) {
      luminance = lambert(texelFetch(uSpheres, place(id, textureSize(uSpheres, 0).x), 0).xyz + s.w * n, n);
    }
    sum = vec4(luminance * colorOf(id), luminance);
    cover = 1.0;
  }
  outSum = sum;
  outCover = cover;
}`;

/** Every uStep-th pixel of the id buffer, for reading back. */
export const SWEEP_FRAGMENT = HEAD + `
uniform usampler2D uIds;
uniform int uStep;
uniform vec2 uFirst;
uniform vec2 uSize;
out uint outId;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) * uStep + ivec2(uFirst);
  outId = all(lessThan(at, ivec2(uSize))) ? texelFetch(uIds, at, 0).r : 0u;
}`;

/** Sums to a picture: mean, tone curve on luminance, colour, background, sRGB. The same as luxel.kernels.shade.develop. */
export const PRESENT_FRAGMENT = HEAD + `
uniform sampler2D uSum, uCover;
uniform vec2 uCanvas;   // pixels shown
uniform vec2 uPart;     // part of the sums that is in use, (0, 1]
uniform float uCount, uExposure, uWhite;
uniform vec3 uTop, uBottom; // background, linear light
out vec4 outColor;

vec3 encode(vec3 c) {
  return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

void main() {
  vec2 at = gl_FragCoord.xy / uCanvas;
  vec4 sum = texture(uSum, at * uPart);
  float hits = texture(uCover, at * uPart).r;
  float cover = min(1.0, hits / uCount), gain = 0.0;
  if (sum.a > 0.0 && hits > 0.0) {
    float v = sum.a / hits * uExposure;
    if (uWhite > 1.0) {
      float toe = pow(uWhite, -0.6), high = toe * uWhite;
      v *= toe;
      v = v * (1.0 + v / (high * high)) / (1.0 + v);
    }
    gain = min(v, 1.0) * cover / sum.a;
  }
  vec3 c = encode(clamp(sum.rgb * gain + mix(uBottom, uTop, at.y) * (1.0 - cover), 0.0, 1.0));
  // A slow gradient shows steps in 8 bits; half a step of noise hides them where there is only background.
  float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
  outColor = vec4(c + noise * (1.0 - cover) / 255.0, 1);
}`;
