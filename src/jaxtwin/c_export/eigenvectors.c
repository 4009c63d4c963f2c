/* The sum of products in four parts, which a processor adds beside each other. */
static double model_dot(const double *a, const double *b)
{
    double sums[4] = {0.0, 0.0, 0.0, 0.0};
    int k, part;
    for (k = 0; k + 4 <= MODEL_NODES; k += 4) {
        for (part = 0; part < 4; ++part) {
            sums[part] += a[k + part] * b[k + part];
        }
    }
    for (; k < MODEL_NODES; ++k) {
        sums[0] += a[k] * b[k];
    }
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

/* Cholesky's factor L of a positive definite matrix L L^T. Its columns become the rows. Returns
   whether the matrix is positive definite. */
static int model_factorise(double matrix[MODEL_NODES][MODEL_NODES])
{
    int i, j, k;
    for (k = 0; k < MODEL_NODES; ++k) {
        const double pivot = sqrt(matrix[k][k]);
        if (!(pivot > 0.0)) {
            return 0;
        }
        for (j = 0; j < MODEL_NODES; ++j) {
            matrix[k][j] = j < k ? 0.0 : matrix[k][j] / pivot;
        }
        for (i = k + 1; i < MODEL_NODES; ++i) {
            for (j = i; j < MODEL_NODES; ++j) {
                matrix[i][j] -= matrix[k][i] * matrix[k][j];
            }
        }
    }
    return 1;
}

/* The eigenvectors of a positive definite matrix by one-sided Jacobi rotations of its Cholesky
   factor (Veselic and Hari, Numer. Math. 56, 1989), with which the small eigenvalues of a stiff
   network keep their digits. The rows of the matrix become its eigenvectors, with squares of
   lengths that are the eigenvalues. Returns whether that has been reached. */
static int model_diagonalise(double matrix[MODEL_NODES][MODEL_NODES], double *values)
{
    const double small = DBL_EPSILON * MODEL_NODES;
    int sweep, p, q, k, is_orthogonal = 0;
    if (!model_factorise(matrix)) {
        return 0;
    }
    for (sweep = 0; sweep < 50 && !is_orthogonal; ++sweep) {
        is_orthogonal = 1;
        for (p = 0; p < MODEL_NODES; ++p) {
            values[p] = model_dot(matrix[p], matrix[p]);
        }
        for (p = 0; p < MODEL_NODES; ++p) {
            for (q = p + 1; q < MODEL_NODES; ++q) {
                double *a = matrix[p], *b = matrix[q];
                const double both = model_dot(a, b);
                double ratio, tangent, cosine, sine;
                if (fabs(both) <= small * sqrt(values[p] * values[q])) {
                    continue;
                }
                is_orthogonal = 0;
                ratio = (values[q] - values[p]) / (2.0 * both);
                tangent = copysign(1.0 / (fabs(ratio) + hypot(1.0, ratio)), ratio);
                cosine = 1.0 / hypot(1.0, tangent);
                sine = tangent * cosine;
                for (k = 0; k < MODEL_NODES; ++k) {
                    const double of_a = a[k], of_b = b[k];
                    a[k] = cosine * of_a - sine * of_b;
                    b[k] = sine * of_a + cosine * of_b;
                }
                values[p] -= tangent * both;
                values[q] += tangent * both;
            }
        }
    }
    return is_orthogonal;
}
