/* A symmetric matrix in its eigenvectors by Jacobi's rotations (Golub and Van Loan, Matrix
   Computations, 4th ed., section 8.5). Of a positive definite matrix the small eigenvalues keep
   their digits beside large ones (Demmel and Veselic, SIAM J. Matrix Anal. Appl. 13, 1992).
   The matrix becomes diagonal, and row k of the vectors belongs to its entry k. Returns whether
   that has been reached. */
static int model_diagonalise(double matrix[MODEL_NODES][MODEL_NODES],
                             double vectors[MODEL_NODES][MODEL_NODES])
{
    int sweep, p, q, k, is_diagonal = 0;
    for (p = 0; p < MODEL_NODES; ++p) {
        for (q = 0; q < MODEL_NODES; ++q) {
            vectors[p][q] = p == q;
        }
    }
    for (sweep = 0; sweep < 50 && !is_diagonal; ++sweep) {
        is_diagonal = 1;
        for (p = 0; p < MODEL_NODES; ++p) {
            for (q = p + 1; q < MODEL_NODES; ++q) {
                const double beside = matrix[p][q];
                const double scale = sqrt(fabs(matrix[p][p] * matrix[q][q]));
                double ratio, tangent, cosine, sine;
                if (fabs(beside) <= DBL_EPSILON * scale) {
                    continue;
                }
                is_diagonal = 0;
                ratio = (matrix[q][q] - matrix[p][p]) / (2.0 * beside);
                tangent = copysign(1.0 / (fabs(ratio) + hypot(1.0, ratio)), ratio);
                cosine = 1.0 / hypot(1.0, tangent);
                sine = tangent * cosine;
                for (k = 0; k < MODEL_NODES; ++k) {
                    const double to_p = matrix[p][k], to_q = matrix[q][k];
                    const double of_p = vectors[p][k], of_q = vectors[q][k];
                    vectors[p][k] = cosine * of_p - sine * of_q;
                    vectors[q][k] = sine * of_p + cosine * of_q;
                    if (k != p && k != q) {
                        matrix[p][k] = matrix[k][p] = cosine * to_p - sine * to_q;
                        matrix[q][k] = matrix[k][q] = sine * to_p + cosine * to_q;
                    }
                }
                matrix[p][p] -= tangent * beside;
                matrix[q][q] += tangent * beside;
                matrix[p][q] = matrix[q][p] = 0.0;
            }
        }
    }
    return is_diagonal;
}

/* Solves matrix * x = right in place, for several columns, by Gauss-Jordan elimination with pivots.
   Returns whether there is a solution. */
static int model_solve(double *matrix, double *right, int size, int columns)
{
    int row, k, j;
    for (k = 0; k < size; ++k) {
        int largest = k;
        for (row = k + 1; row < size; ++row) {
            if (fabs(matrix[row * size + k]) > fabs(matrix[largest * size + k])) {
                largest = row;
            }
        }
        if (!(fabs(matrix[largest * size + k]) > 0.0)) {
            return 0;
        }
        for (j = 0; j < size; ++j) {
            const double kept = matrix[k * size + j];
            matrix[k * size + j] = matrix[largest * size + j];
            matrix[largest * size + j] = kept;
        }
        for (j = 0; j < columns; ++j) {
            const double kept = right[k * columns + j];
            right[k * columns + j] = right[largest * columns + j];
            right[largest * columns + j] = kept;
        }
        for (row = 0; row < size; ++row) {
            const double factor = matrix[row * size + k] / matrix[k * size + k];
            if (row == k || factor == 0.0) {
                continue;
            }
            for (j = k; j < size; ++j) {
                matrix[row * size + j] -= factor * matrix[k * size + j];
            }
            for (j = 0; j < columns; ++j) {
                right[row * columns + j] -= factor * right[k * columns + j];
            }
        }
    }
    for (k = 0; k < size; ++k) {
        for (j = 0; j < columns; ++j) {
            right[k * columns + j] /= matrix[k * size + k];
        }
    }
    return 1;
}
