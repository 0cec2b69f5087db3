/* A ray map as plain C has it: rows of a camera without lens terms through clear spheres, from the highest down.

   What anyone would write who knows the formulas and wants it quick: pixels beside every silhouette go straight to
   the plane, a block of the others asks a sphere only if its silhouette reaches into the block or the block has
   been bent before.  Rays that meet spheres in another order than that of their heights are not foreseen.

   camera: pinhole, right, down, ahead (3 each), focal_px, principal pixel u, v.  balls: x, y, z, R, n a sphere. */
#include <math.h>
#include <stdint.h>
enum { BLOCK = 256, MOST = 16 };

static int least(int a, int b) { return a < b ? a : b; }
static int most(int a, int b) { return a > b ? a : b; }

void trace_rows(const double *restrict c, const double *restrict balls, int count, int width, int first, int last,
                double *restrict point, uint8_t *restrict status, uint16_t *restrict branch)
{
    double p[3][BLOCK], d[3][BLOCK];
    int low[MOST], high[MOST], code[BLOCK];
    for (int row = first; row < last; row++) {
        const double f = 1.0 / c[12], y = (row - c[14]) * f, ox = c[0], oy = c[1], oz = c[2];
        for (int k = 0; k < count; k++) { /* (w . d)^2 > (w . w - R^2) d . d, a quadratic in x */
            const double *b = balls + 5 * k, w[3] = { c[0] - b[0], c[1] - b[1], c[2] - b[2] };
            const double out = w[0] * w[0] + w[1] * w[1] + w[2] * w[2] - b[3] * b[3];
            const double u = c[3] * w[0] + c[4] * w[1] + c[5] * w[2], v = c[6] * w[0] + c[7] * w[1] + c[8] * w[2];
            const double rest = v * y + c[9] * w[0] + c[10] * w[1] + c[11] * w[2];
            const double A = u * u - out, B = u * rest, C = rest * rest - out * (y * y + 1.0), root = B * B - A * C;
            low[k] = high[k] = 0;
            if (root < 0.0) continue;
            low[k] = most(0, (int)fmax(0.0, floor((-B + sqrt(root)) / A * c[12] + c[13]) - 1.0));
            high[k] = least(width, (int)fmin(width, ceil((-B - sqrt(root)) / A * c[12] + c[13]) + 2.0));
        }
        for (int at = 0, end; at < width; at = end) {
            int inside = 0;
            end = width;
            for (int k = 0; k < count; k++) {
                if (low[k] <= at && at < high[k]) inside = 1;
                if (low[k] > at && low[k] < end) end = low[k];
            }
            if (inside) end = least(width, at + BLOCK);
            double *restrict q = point + 2 * ((int64_t)row * width + at);
            uint8_t *restrict s = status + (int64_t)row * width + at;
            uint16_t *restrict name = branch + (int64_t)row * width + at;
            const int n = end - at;
            if (!inside) {
                for (int i = 0; i < n; i++) {
                    const double x = (at + i - c[13]) * f, dz = c[5] * x + c[8] * y + c[11], t = -oz / dz;
                    const double tx = ox + t * (c[3] * x + c[6] * y + c[9]), ty = oy + t * (c[4] * x + c[7] * y + c[10]);
                    q[2 * i] = dz < 0.0 ? tx : NAN;
                    q[2 * i + 1] = dz < 0.0 ? ty : NAN;
                    s[i] = dz < 0.0 ? 0 : 3;
                    name[i] = 0;
                }
                continue;
            }
            for (int i = 0; i < n; i++) {
                const double x = (at + i - c[13]) * f, e = 1.0 / sqrt(x * x + y * y + 1.0);
                for (int a = 0; a < 3; a++) {
                    p[a][i] = c[a];
                    d[a][i] = (c[3 + a] * x + c[6 + a] * y + c[9 + a]) * e;
                }
                code[i] = 0;
            }
            for (int k = 0, bent = 0; k < count; k++) {
                if (!bent && (high[k] <= at || low[k] >= end)) continue;
                bent = 1;
                const double *b = balls + 5 * k, cx = b[0], cy = b[1], cz = b[2], r2 = b[3] * b[3];
                const double ir = 1.0 / b[3], nu = 1.0 / b[4];
                for (int i = 0; i < n; i++) {
                    const double dx = d[0][i], dy = d[1][i], dz = d[2][i], px = p[0][i], py = p[1][i], pz = p[2][i];
                    const double m = -((px - cx) * dx + (py - cy) * dy + (pz - cz) * dz);
                    const double ax = px - cx + m * dx, ay = py - cy + m * dy, az = pz - cz + m * dz;
                    const double b2 = ax * ax + ay * ay + az * az, chi = b2 < r2 ? b2 * ir * ir : 1.0;
                    const int hit = (b2 < r2) & (m > 0.0);
                    const double ci = sqrt(1.0 - chi), ct = sqrt(1.0 - chi * nu * nu);
                    const double g = (1.0 - nu * nu) / (ct + ci * nu), cosine = 1.0 - 2.0 * chi * g * g;
                    const double turn = 2.0 * g * (ci * ct + chi * nu) * ir, along = b2 * turn;
                    p[0][i] = hit ? cx + ax * cosine + dx * along : px;
                    p[1][i] = hit ? cy + ay * cosine + dy * along : py;
                    p[2][i] = hit ? cz + az * cosine + dz * along : pz;
                    d[0][i] = hit ? dx * cosine - ax * turn : dx;
                    d[1][i] = hit ? dy * cosine - ay * turn : dy;
                    d[2][i] = hit ? dz * cosine - az * turn : dz;
                    code[i] |= hit << k;
                }
            }
            for (int i = 0; i < n; i++) {
                const double dz = d[2][i], t = -p[2][i] / dz;
                const double tx = p[0][i] + t * d[0][i], ty = p[1][i] + t * d[1][i];
                q[2 * i] = dz < 0.0 ? tx : NAN;
                q[2 * i + 1] = dz < 0.0 ? ty : NAN;
                s[i] = dz < 0.0 ? 0 : 3;
                name[i] = code[i];
            }
        }
    }
}
